"""Captures with one transforms.json, as instant-ngp and nerfstudio write it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DatasetError, listed
from ..formats.colmap_model import Model
from ..formats.names import path_below
from ..formats.photograph import Photograph
from ..formats.point_clouds import RandomPoints, read_point_cloud
from ..formats.transforms_json import FrameFile, read_frames, without_common_folder
from ..photographs.fitting import fit_to_files
from ..photographs.sidecars import with_sidecars
from ..settings import parse_dataset_settings, require_folder
from ..source import Source
from ..store.contents import digest_of
from .photograph_files import files_of, refuse_missing
from .settings import TransformsSettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 6  # raise it with every change that alters a scene
MODEL_VERSION = 2  # and this with every change that alters a model
FEATURE_SIZE = 3200  # pixels along the longer side, for finding features: COLMAP's own
NGP_SCALE, NGP_OFFSET = 0.33, 0.5  # instant-ngp's defaults; aabb_scale enlarges its box [0, 1]³ around the middle
NGP_RANGE = 1e-6, 1e6  # of its scales


def load_transforms(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A capture whose cameras are in one JSON file: camera to world, OpenGL axes, in the file's world.

    Of all frames or of each: fl_x, fl_y or camera_angle_x, camera_angle_y; cx, cy, w, h; camera_model, k1 … k4, p1, p2;
    of a frame: file_path (with or without extension), transform_matrix, mask_path (region `foreground`). Points come
    from ply_file_path, else they are random, in the box that aabb_scale (with scale and offset) gives instant-ngp.
    `masks/`, `masks_<region>/` and `normals/` as for `colmap`. applied_transform is not undone: poses and points both
    have it.

    Raises:
        DatasetError: anything missing, unreadable or contradictory; the message names the file or key.
    """
    from .capture import cached_capture, make_scene  # with torch, without which files are found

    choice = parse_dataset_settings(TransformsSettings, settings)
    root = choice.root
    require_folder(root)
    file = read_frames(path_below(root, choice.file, root))
    found, missing = _photographs(file, choice)
    photographs = with_sidecars(found, root, choice.normals_frame)
    ply = _cloud_file(file)

    def make() -> Scene:
        refuse_missing(choice.missing, len(file.frames), missing, file.path)
        cloud = read_point_cloud(ply) if ply else _random_points(choice, file)
        return make_scene(choice, photographs, cloud, file.path)

    return cached_capture(choice, VERSION, _files(file, photographs), cache_dir, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """What `load_transforms` makes the scene from."""
    choice = parse_dataset_settings(TransformsSettings, settings)
    file = read_frames(path_below(choice.root, choice.file, choice.root))
    return _files(file, with_sidecars(_photographs(file, choice)[0], choice.root, choice.normals_frame))


def photographs_of(settings: Mapping[str, Any], cache_dir: Path) -> list[Photograph]:
    """What `load_transforms` makes its views from."""
    choice = parse_dataset_settings(TransformsSettings, settings)
    return _photographs(read_frames(path_below(choice.root, choice.file, choice.root)), choice)[0]


def model_of(settings: Mapping[str, Any], cache_dir: Path) -> Model:
    """The file's poses with points that SIFT's matches give them, from the cache or made now.

    Raises:
        DatasetError: as `load_transforms`, or the photographs share no point that fits their poses.
    """
    from ..photographs.reconstruction import Reconstructor

    choice = parse_dataset_settings(TransformsSettings, settings)
    require_folder(choice.root)
    file = read_frames(path_below(choice.root, choice.file, choice.root))
    found, missing = _photographs(file, choice)
    refuse_missing(choice.missing, len(file.frames), missing, file.path)
    photographs = fit_to_files(found)
    turned = [photograph.path.name for photograph in photographs if photograph.turned]
    if turned:
        raise DatasetError(
            f"{file.path}: points need pixels as their cameras have them; save upright: {listed(turned)}"
        )
    contents = digest_of([file.path, *(photograph.path for photograph in photographs)], choice.root, cache_dir)
    how = Reconstructor("sift", "as given", "exhaustive", FEATURE_SIZE)
    return how.triangulated(photographs, cache_dir / "models" / f"triangulated-{MODEL_VERSION}-{contents[:16]}")


def _files(file: FrameFile, photographs: Sequence[Photograph]) -> list[Path]:
    return [file.path, *filter(None, [_cloud_file(file)]), *files_of(photographs)]


def _cloud_file(file: FrameFile) -> Path | None:
    named = file.shared.get("ply_file_path")
    return path_below(file.root, str(named), file.path) if named else None


def _photographs(file: FrameFile, choice: TransformsSettings) -> tuple[list[Photograph], list[str]]:
    """The photographs, named by their paths below the folder that all share, and the names of those not there."""
    found, missing = file.photographs(choice.images)
    names = without_common_folder([photograph.name for photograph in found])
    return [replace(photograph, name=name) for photograph, name in zip(found, names, strict=True)], missing


def _random_points(choice: TransformsSettings, file: FrameFile) -> RandomPoints:
    if choice.random_box is not None:
        return RandomPoints(choice.random_points, choice.random_box)
    aabb = file.within("aabb_scale", {}, *NGP_RANGE)
    if aabb is None:
        raise DatasetError(
            f"{file.path}: names no points to start from (ply_file_path) and no box (aabb_scale); give the half edge "
            "of a box for random ones, in the file's units: dataset.random_box=…"
        )
    scale = file.within("scale", {}, *NGP_RANGE) or NGP_SCALE
    offset = file.shared.get("offset") or [NGP_OFFSET] * 3
    if not isinstance(offset, list) or len(offset) != 3:
        raise DatasetError(f"{file.path}: offset={str(offset)[:60]!r}, expected three numbers")
    x, y, z = ((0.5 - (file.number("offset", {"offset": shift}) or 0)) / scale for shift in offset)
    return RandomPoints(choice.random_points, aabb / 2 / scale, (x, y, z))


SOURCE = Source(load_transforms, files_read, photographs_of=photographs_of, model_of=model_of, places=True)
