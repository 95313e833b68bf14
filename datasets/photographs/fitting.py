"""Fitting: cameras at the sizes of their photographs' files, and all that belongs together of one shape."""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pycolmap

from ..consistency.intrinsics import check_intrinsics
from ..consistency.lenses import check_lenses
from ..errors import DatasetError, listed
from ..formats.mask_file import mask_size
from ..formats.photograph import Photograph
from ..formats.pictures import read_header
from ..notes import note


def fit_to_files(photographs: Sequence[Photograph]) -> list[Photograph]:
    """The photographs with their cameras at the sizes of their files, which may be reduced copies.

    Pixels are taken as they lie in the file, as COLMAP takes them, whatever its EXIF orientation says; unless the
    camera has the turned picture's shape and not the file's.

    Raises:
        DatasetError: a file is no picture or has another shape than its camera; files of one camera differ in size;
            masks or normals have another shape than their picture; names are not unique; a camera cannot have taken
            its pictures.
    """
    _refuse_equal_names(photographs)
    fitted = [fit_to_file(photograph) for photograph in photographs]
    _refuse_mixed_sizes(fitted)
    _check_sidecars(fitted)
    check_intrinsics(fitted)
    check_lenses(fitted)
    return fitted


def _refuse_equal_names(photographs: Iterable[Photograph]) -> None:
    by_file: dict[Path, list[str]] = defaultdict(list)
    by_name: dict[str, list[str]] = defaultdict(list)
    for photograph in photographs:
        by_file[photograph.path].append(photograph.name)
        by_name[photograph.view_name].append(photograph.name)
    for path, names in by_file.items():
        if len(names) > 1:
            raise DatasetError(
                f"{path}: is listed {len(names)} times, as {listed(names)}; one picture has one pose: remove the others"
            )
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


def _check_sidecars(photographs: Sequence[Photograph]) -> None:
    """Masks and normals have their picture's shape; where they have another size, that is noted."""
    others: dict[Path, list[str]] = defaultdict(list)
    for photograph in photographs:
        sizes = ((path, mask_size(path)) for path in photograph.masks.values())
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
        note(f"{folder}: resampled, being of another size than the images: {listed(sorted(names))}")
