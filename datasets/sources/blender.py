"""Blender scenes: rendered objects with their split, as NeRF's and Ref-NeRF's synthetic data sets have them."""

from __future__ import annotations

import glob
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..formats.normal_maps import NormalMap
from ..formats.photograph import Photograph
from ..formats.point_clouds import read_point_cloud
from ..formats.transforms_json import read_frames
from ..photographs.sidecars import with_masks
from ..settings import parse_dataset_settings, require_folder
from ..source import Source
from ..split import validation_of
from .photograph_files import files_of, refuse_missing
from .settings import BlenderSettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 5  # raise it with every change that alters a scene
TRANSFORMS = ("transforms_train.json", "transforms_test.json")
POINTS = "points3d.ply"  # what 3DGS writes beside such a scene


def load_blender(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A rendered scene, split as its files say.

        transforms_train.json, transforms_test.json   camera_angle_x; file_path and transform_matrix of each frame
        train/…, test/…                               the pictures; transparent ones are laid on `background`
        train/…, test/<view>_normal.png or .npy       optional: exact normals, world frame
        masks/…, masks_<region>/…                     optional, as masks/test/r_0.png
        points3d.ply                                  optional: points to start from

    Raises:
        DatasetError: anything missing, unreadable or contradictory; the message names the file or key.
    """
    from .blender_scene import make_blender_scene  # with torch, without which files are found
    from .capture import cached_capture

    choice = parse_dataset_settings(BlenderSettings, settings)
    root = choice.root
    require_folder(root)
    files = [read_frames(root / name) for name in TRANSFORMS]
    found = [file.photographs() for file in files]
    learned = found[0][0]
    photographs = _with_sidecars(choice, *(photographs for photographs, _ in found))

    def make() -> Scene:
        for file, (_, missing) in zip(files, found, strict=True):
            refuse_missing(choice.missing, len(file.frames), missing, file.path)
        measured = read_point_cloud(root / POINTS) if (root / POINTS).is_file() else None
        return make_blender_scene(choice, photographs, len(learned), measured)

    return cached_capture(choice, VERSION, _files(choice, photographs), cache_dir, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """What `load_blender` makes the scene from."""
    choice = parse_dataset_settings(BlenderSettings, settings)
    return _files(
        choice, _with_sidecars(choice, *(read_frames(choice.root / name).photographs()[0] for name in TRANSFORMS))
    )


def photographs_of(settings: Mapping[str, Any], cache_dir: Path) -> list[Photograph]:
    """What `load_blender` makes its views from."""
    root = parse_dataset_settings(BlenderSettings, settings).root
    return [photograph for name in TRANSFORMS for photograph in read_frames(root / name).photographs()[0]]


def _with_sidecars(
    choice: BlenderSettings, learned: Sequence[Photograph], tested: Sequence[Photograph]
) -> list[Photograph]:
    """All photographs with their masks, and with normals where they are scored or learned from."""
    scored = {photograph.name for photograph in validation_of(learned)}
    learned = [_with_normal(p) if choice.train_normals or p.name in scored else p for p in learned]
    return with_masks([*learned, *map(_with_normal, tested)], choice.root)


def _files(choice: BlenderSettings, photographs: Sequence[Photograph]) -> list[Path]:
    return [*(choice.root / name for name in (*TRANSFORMS, POINTS)), *files_of(photographs)]


def _with_normal(photograph: Photograph) -> Photograph:
    """The photograph with the normals that lie beside its picture, where they do."""
    stem = photograph.path.with_suffix("").name
    candidates = [photograph.path.with_name(f"{stem}_normal{extension}") for extension in (".npy", ".png")]
    candidates += sorted(
        photograph.path.parent.glob(f"{glob.escape(stem)}_normal_*.png")
    )  # with Blender's number of the frame
    path = next((candidate for candidate in candidates if candidate.is_file()), None)
    return replace(photograph, normal=NormalMap(path, rendered=True) if path else None)


SOURCE = Source(load_blender, files_read, photographs_of=photographs_of, places=True)
