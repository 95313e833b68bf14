"""Photographs: pictures on disk with their cameras, before any pixel is read."""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap
from numpy.typing import NDArray

from ..formats.normal_maps import Frame, NormalMap
from ..formats.pictures import read_header
from ..paths import listed
from ..settings import DatasetError
from ..store.cache import Draft
from .siblings import Siblings, region_folders


@dataclass(frozen=True)
class Photograph:
    """One picture with a pose, and the files that belong to it."""

    name: str  # as the data name it: a path, unique among the photographs
    path: Path
    camera: pycolmap.Camera  # of its file's size once fitted; may be distorted
    camera_id: str  # photographs of one camera have one size
    world_to_camera: NDArray[np.float64]  # [4, 4]
    masks: dict[str, Path] = field(default_factory=dict)  # by region
    normal: NormalMap | None = None
    turned: bool = False  # EXIF's orientation is to be applied
    gains: tuple[float, float, float] | None = None  # a channel, that its bytes are multiplied by

    @property
    def view_name(self) -> str:
        """The name without its extension, in one piece: `left/1.jpg` is the view `left_1`."""
        return PurePosixPath(self.name).with_suffix("").as_posix().replace("/", "_")


def with_siblings(photographs: Sequence[Photograph], root: Path, frame: Frame) -> list[Photograph]:
    """The photographs with the masks and normals that lie in folders below `root`, where there are such folders.

    Raises as `with_masks`.
    """
    result = with_masks(photographs, root)
    if (root / "normals").is_dir():
        paths = Siblings(root / "normals").find_all(photograph.name for photograph in photographs)
        result = [replace(p, normal=NormalMap(path, frame)) for p, path in zip(result, paths, strict=True)]
    return result


def with_masks(photographs: Sequence[Photograph], root: Path) -> list[Photograph]:
    """The photographs with the masks below `root`; those that a photograph has already stay.

    Raises:
        DatasetError: a folder lacks a file for some of them, or holds several for one.
    """
    result = list(photographs)
    for region, folder in region_folders(root).items():
        paths = Siblings(folder).find_all(photograph.name for photograph in photographs)
        result = [replace(p, masks={region: path, **p.masks}) for p, path in zip(result, paths, strict=True)]
    return result


def fit_to_files(photographs: Sequence[Photograph], draft: Draft) -> list[Photograph]:
    """The photographs with their cameras at the sizes of their files, which may be reduced copies.

    Pixels are taken as they lie in the file, as COLMAP takes them, whatever its EXIF orientation says; unless the
    camera has the turned picture's shape and not the file's.

    Raises:
        DatasetError: a file is no picture or has another shape than its camera; files of one camera differ in size;
            masks or normals have another shape than their picture; names are not unique.
    """
    _refuse_equal_names(photographs)
    fitted = [fit_to_file(photograph) for photograph in photographs]
    _refuse_mixed_sizes(fitted)
    _check_siblings(fitted, draft)
    return fitted


def _refuse_equal_names(photographs: Iterable[Photograph]) -> None:
    by_name: dict[str, list[str]] = defaultdict(list)
    for photograph in photographs:
        by_name[photograph.view_name].append(photograph.name)
    for view_name, names in by_name.items():
        if len(names) > 1:
            raise DatasetError(
                f"several images are called {view_name}: {listed(names)}; rename them or remove all but one"
            )


def _refuse_mixed_sizes(photographs: Sequence[Photograph]) -> None:
    """A conversion that stopped half-way leaves files of two sizes."""
    sizes: dict[str, dict[tuple[int, int], list[str]]] = defaultdict(lambda: defaultdict(list))
    for photograph in photographs:
        sizes[photograph.camera_id][photograph.camera.width, photograph.camera.height].append(photograph.name)
    for by_size in sizes.values():
        if len(by_size) > 1:
            found = "; ".join(f"{width}×{height}: {listed(names)}" for (width, height), names in by_size.items())
            raise DatasetError(
                f"{photographs[0].path.parent}: images of one camera have several sizes ({found}); make them one size"
            )


def fit_to_file(photograph: Photograph) -> Photograph:
    """The photograph with its camera at the size of its file, alone; raises as `fit_to_files`."""
    header, camera = read_header(photograph.path), photograph.camera
    stored, turned = (header.width, header.height), (header.height, header.width)
    use_turned = header.turned and not _same_shape(stored, camera) and _same_shape(turned, camera)
    width, height = turned if use_turned else stored
    if not _same_shape((width, height), camera):
        raise DatasetError(
            f"{photograph.path}: is {width}×{height} pixels, its camera {camera.width}×{camera.height}: not the same "
            "shape; use the images that the cameras were made for, or copies of them reduced as a whole"
        )
    if (width, height) != (camera.width, camera.height):
        camera = copy.deepcopy(camera)
        camera.rescale(width, height)
    return replace(photograph, camera=camera, turned=use_turned)


def _same_shape(size: tuple[int, int], camera: pycolmap.Camera) -> bool:
    """Whether `size` is the camera's, scaled and rounded up or down."""
    return abs(size[0] / camera.width - size[1] / camera.height) <= 1 / camera.width + 1 / camera.height


def _check_siblings(photographs: Sequence[Photograph], draft: Draft) -> None:
    """Masks and normals have their picture's shape; where they have another size, the draft notes it."""
    others: dict[Path, list[str]] = defaultdict(list)
    for photograph in photographs:
        sizes = ((path, _size(path)) for path in photograph.masks.values())
        normal = photograph.normal
        for path, size in chain(sizes, [(normal.path, normal.size())] if normal else []):
            camera = photograph.camera
            if not _same_shape(size, camera):
                raise DatasetError(
                    f"{path}: is {size[0]}×{size[1]} pixels, its image {photograph.path.name} is "
                    f"{camera.width}×{camera.height}: not the same shape; make it of the whole image"
                )
            if size != (camera.width, camera.height):
                others[path.parent].append(path.name)
    for folder, names in others.items():
        draft.note(f"{folder}: resampled, being of another size than the images: {listed(sorted(names))}")


def _size(path: Path) -> tuple[int, int]:
    header = read_header(path)
    return header.width, header.height
