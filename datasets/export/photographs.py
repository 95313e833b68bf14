"""Photographs: a published folder of them, made into a capture in COLMAP's layout, undistorted and of another size."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..errors import DatasetError
from ..formats.colmap_model import Model
from ..formats.names import stem_of
from ..photographs.fitting import fit_to_files
from ..photographs.sidecars import with_masks
from ..photographs.undistortion import undistorted_camera
from ..photographs.views import read_views
from ..progress import report
from ..registry import source_of
from ..store.scene_file import on_disk
from .files import ViewFiles, write_views

BLACK = (0.0, 0.0, 0.0)


def export_photographs(source: Mapping[str, Any], width: int, root: Path, cache_dir: Path) -> int:
    """Write the photographs as `images/` and `sparse/0/` below `root`, which is all there at the end or not at all.

    The model keeps which image shows which points, and where: exposures are told by that. Masks follow the pictures.

    Args:
        source: settings of `kind: photos`, whose cameras are found, or `kind: transforms`, which has them.
        width: of the pictures, pixels; their height follows.

    Returns:
        How many images were written.

    Raises:
        DatasetError: as these sources, or `width` is more than the photographs have.
        OSError: it cannot be written.
    """
    kind = source_of(source["kind"])
    if kind.model_of is None or kind.photographs_of is None:
        raise DatasetError(f"kind={source['kind']!r}: tells no poses and points of photographs, as photos does")
    model = kind.model_of(source, cache_dir)
    photographs = fit_to_files(with_masks(kind.photographs_of(source, cache_dir), Path(source["root"])))
    widest = undistorted_camera(photographs[0].camera).width
    if not 1 <= width <= widest:
        raise DatasetError(f"{source['root']}: {widest} pixels wide once undistorted; expected {width} at least")
    views = on_disk(read_views(photographs, widest / width, BLACK))
    sizes = {p.name: (v.camera.width, v.camera.height) for p, v in zip(photographs, views, strict=True)}
    stems = [stem_of(photograph.name) for photograph in photographs]
    names = {photograph.name: f"{stem}.png" for photograph, stem in zip(photographs, stems, strict=True)}
    part = root.with_name(f".{root.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        (part / "sparse/0").mkdir(parents=True)
        undistorted(model, sizes, names).write_binary(str(part / "sparse/0"))
        files = [ViewFiles(view, f"images/{stem}", stem, "") for view, stem in zip(views, stems, strict=True)]
        write_views(part, files)
        part.replace(root)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return len(views)


def undistorted(
    model: Model, sizes: Mapping[str, tuple[int, int]], names: Mapping[str, str]
) -> pycolmap.Reconstruction:
    """The model as pinholes of these sizes see it, its images called by these names, both by the images' own."""
    content = model.content
    pinholes = {}
    for done, image in enumerate(content.images.values(), start=1):
        camera = content.cameras[image.camera_id]
        pinhole = copy.deepcopy(undistorted_camera(camera))
        pinhole.rescale(*sizes[image.name])
        pinholes[image.camera_id] = pinhole
        if len(image.points2D):
            places = np.array([point.xy for point in image.points2D])
            rays = np.asarray(camera.cam_from_img(places))
            seen = np.asarray(pinhole.img_from_cam(np.column_stack([rays, np.ones(len(rays))])))
            for point, place in zip(image.points2D, seen, strict=True):
                point.xy = place.tolist()
        image.name = names[image.name]
        report("undistorting the model", done, len(content.images))
    for number, pinhole in pinholes.items():
        camera = content.cameras[number]
        camera.model, camera.params = pinhole.model, pinhole.params.tolist()
        camera.width, camera.height = pinhole.width, pinhole.height
    content.update_point_3d_errors()
    return content
