"""Captures: what every source of photographs has in common, from settings to the cached scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import torch

from envgs_bench.core import Scene

from ..formats.photograph import Photograph
from ..formats.point_clouds import PointCloud, RandomPoints, far_points
from ..photographs.fitting import fit_to_files
from ..photographs.normal_estimation import estimator_version, with_estimated_normals
from ..photographs.placing import placed_cloud, placed_photographs
from ..photographs.views import read_views
from ..split import split_views, validation_of, without_normals
from ..store.cache import cached_scene
from ..store.contents import digest_of
from ..store.scene_file import on_disk
from .settings import CaptureSettings, PhotographSettings


def cached_capture(
    settings: CaptureSettings, version: int, files: Iterable[Path], cache_dir: Path, make: Callable[[], Scene]
) -> Scene:
    """The scene that `make` makes of these settings and files, from the cache where both are the same as before.

    Args:
        version: the source's, raised with its code.
        files: all that the scene is made from; those that do not exist are left out.
    """
    key = {
        "version": version,
        **settings.model_dump(mode="json", exclude={"root"}),
        "name": settings.scene_name,
        "contents": digest_of((path for path in files if path.is_file()), settings.root, cache_dir),
        "estimator": estimator_version(settings.normal_estimator),
    }
    return cached_scene(cache_dir, settings.scene_name, key, make)


def make_scene(
    settings: PhotographSettings, photographs: Sequence[Photograph], cloud: PointCloud | RandomPoints, source: Path
) -> Scene:
    """The scene of these photographs, every eighth of which tests; `source` names them in errors.

    Poses and points come in the data's coordinates. Views that are scored keep their normals only where these are
    exact.
    """
    measured = cloud if isinstance(cloud, PointCloud) else None
    ordered = sorted(photographs, key=lambda photograph: photograph.name)
    fitted, placement = placed_photographs(fit_to_files(ordered), measured, source)
    started = placed_cloud(cloud, placement) if isinstance(cloud, PointCloud) else cloud.placed(placement)
    views = on_disk(read_views(fitted, settings.downsample, settings.background, settings.mask_labels))
    train, test = split_views(views, str(source))
    val = validation_of(train)
    if not settings.exact_normals:
        val, test = without_normals(val), without_normals(test)
    train = on_disk(with_estimated_normals(train, settings.normal_estimator))
    far = far_points(torch.stack([view.camera.center for view in train]), settings.far_points)
    points, colors = (torch.cat(parts) for parts in zip(started, far, strict=True))
    background = torch.tensor(settings.background)
    return Scene(settings.scene_name, train, test, points, colors, background, val, placement=placement)
