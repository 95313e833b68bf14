"""Models: what COLMAP knows of a capture, read by pycolmap from text or binary files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap
from numpy.typing import NDArray

from envgs_bench.regular_file import require_regular

from ..errors import DatasetError
from . import colmap_text
from .colmap_binary import COUNT, check_sizes, image_names
from .image_files import ImageFiles
from .photograph import LONGEST_EDGE, Photograph
from .point_clouds import PointCloud, point_cloud, read_point_cloud

PARTS = ("cameras", "images", "points3D")
PLY = ".ply"  # as which some programs leave the points beside cameras and images


@dataclass(frozen=True)
class Observations:
    """Where one image shows points of the model."""

    positions: NDArray[np.float64]  # [K, 2] x, y in pixels of the image that the model was made from
    points: NDArray[np.int64]  # [K] which points


@dataclass(frozen=True)
class Model:
    """Cameras, images and points3D, as .bin or .txt, in one folder; points3D may be a .ply instead."""

    folder: Path

    @property
    def exists(self) -> bool:
        return any((self.folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))

    @cached_property
    def content(self) -> pycolmap.Reconstruction:
        """All of it.

        Raises:
            DatasetError: it cannot be read.
        """
        return _read(self.folder, self._suffix)

    @property
    def files(self) -> list[Path]:
        """The files that it is read from."""
        parts = _parts(self.folder, self._suffix)
        return parts if self._has_points else [*parts, *filter(Path.is_file, [self.folder / f"points3D{PLY}"])]

    def listed_images(self) -> list[str]:
        """The names of all images, also of those without a pose; points and observations are not read.

        Raises:
            DatasetError: it cannot be read.
        """
        path = self.folder / f"images{self._suffix}"
        try:
            return image_names(path) if path.suffix == ".bin" else list(colmap_text.image_names(path).values())
        except (OSError, ValueError, IndexError):
            return [image.name for image in self.content.images.values()]  # or pycolmap says what is wrong

    @property
    def _suffix(self) -> str:
        """Of the form that is complete, or else of that which lacks its points alone, or else of text; binary first."""
        for parts in (PARTS, PARTS[:2]):
            for suffix in (".bin", ".txt"):
                if all((self.folder / f"{part}{suffix}").exists() for part in parts):
                    return suffix
        return ".bin" if (self.folder / "cameras.bin").exists() else ".txt"

    @property
    def _has_points(self) -> bool:
        return (self.folder / f"points3D{self._suffix}").exists()

    @property
    def image_names(self) -> list[str]:
        """The images that have a pose, sorted: paths below the images' folder."""
        return sorted(image.name for image in self.content.images.values() if image.has_pose)

    def points(self) -> PointCloud:
        """The triangulated points, from points3D.ply where the model itself has none; raises as `point_cloud`."""
        if not self._has_points:
            return read_point_cloud(self.folder / f"points3D{PLY}")
        found = [self.content.points3D[key] for key in sorted(self.content.points3D)]
        points = np.array([point.xyz for point in found]).reshape(-1, 3)
        return point_cloud(points, np.array([point.color for point in found]).reshape(-1, 3) / 255, self.folder)

    def photographs(self, images: Path) -> tuple[list[Photograph], list[str]]:
        """The images with a pose, in the order of their names, and the names of those that are not in `images`.

        Raises:
            DatasetError: no image has a pose, a number is not finite, a camera has no pixels, or a name leaves the
                folder.
        """
        registered = sorted((image for image in self.content.images.values() if image.has_pose), key=lambda i: i.name)
        if not registered:
            raise DatasetError(f"{self.folder}: the model has no image with a pose")
        cameras = dict(self.content.cameras)
        files = ImageFiles(images, self.listed_images(), self.folder)
        found, missing = [], []
        for image in registered:
            path = files.find(image.name)
            if path is None:
                missing.append(image.name)
                continue
            camera = cameras[image.camera_id]
            self._check_size(camera, image.name)
            self._check_finite(f"camera {image.camera_id}", camera.params, image.name)
            found.append(Photograph(image.name, path, camera, str(image.camera_id), self._pose(image)))
        files.note_converted()
        return found, missing

    def observations(self) -> dict[str, Observations]:
        """Where each image shows which points, by the images' names."""
        return {image.name: _observations(image) for image in self.content.images.values()}

    def _pose(self, image: pycolmap.Image) -> np.ndarray:
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        self._check_finite("pose", pose, image.name)
        return pose

    def _check_size(self, camera: pycolmap.Camera, name: str) -> None:
        if not (1 <= camera.width <= LONGEST_EDGE and 1 <= camera.height <= LONGEST_EDGE):
            raise DatasetError(
                f"{self.folder}: camera {camera.camera_id} of image {name} is {camera.width}×{camera.height} pixels, "
                f"expected 1 to {LONGEST_EDGE:,} along each edge; repair it"
            )

    def _check_finite(self, what: str, values: np.ndarray, name: str) -> None:
        if not np.isfinite(values).all():
            raise DatasetError(f"{self.folder}: the {what} of image {name} is not finite; repair or remove it")


def _observations(image: pycolmap.Image) -> Observations:
    seen = [point for point in image.points2D if point.has_point3D()]
    positions = np.array([point.xy for point in seen]).reshape(-1, 2)
    return Observations(positions, np.array([point.point3D_id for point in seen], dtype=np.int64))


def _read(folder: Path, suffix: str) -> pycolmap.Reconstruction:
    missing = [part for part in PARTS[:2] if not (folder / f"{part}{suffix}").exists()]
    if missing:
        raise DatasetError(f"{folder}: has no {missing[0]}{suffix}; export the model as a whole, in one form")
    if not any((folder / f"points3D{end}").exists() for end in (suffix, PLY)):
        raise DatasetError(
            f"{folder}: has cameras and images, and neither points3D{suffix} nor points3D{PLY}, which methods start "
            "from; export the points too, or find some with colmap point_triangulator"
        )
    try:
        for path in (*folder.glob("*.txt"), *folder.glob("*.bin")):
            require_regular(path)
        if suffix == ".bin":
            check_sizes(folder)
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error) from error
    try:
        with _readable(folder, suffix) as readable:
            model = pycolmap.Reconstruction(str(readable))
        if suffix == ".txt":
            for number, name in colmap_text.image_names(folder / "images.txt").items():
                model.images[number].name = name
        for image in model.images.values():
            image.name.encode()  # pycolmap decodes names when they are asked for
        return model
    except Exception as error:  # pycolmap raises whatever its C++ does
        odd = _not_finite(folder)
        if odd:
            raise DatasetError(f"{odd}: this line holds a number that is not finite; repair or remove it") from error
        raise _unreadable(folder, error) from error


@contextmanager
def _readable(folder: Path, suffix: str) -> Iterator[Path]:
    """A folder from which pycolmap reads the model: its own, or a copy without byte order marks, and with no points
    where these are elsewhere."""
    files = _parts(folder, suffix)
    marked = {path for path in files if suffix == ".txt" and colmap_text.begins_with_mark(path)}
    if not marked and folder / f"points3D{suffix}" in files:
        yield folder
        return
    with TemporaryDirectory() as name:
        copy = Path(name)
        (copy / f"points3D{suffix}").write_bytes(b"" if suffix == ".txt" else bytes(COUNT.size))
        for path in files:
            if path in marked:
                (copy / path.name).write_text(colmap_text.without_mark(path), encoding="utf-8")
            else:
                (copy / path.name).unlink(missing_ok=True)
                (copy / path.name).symlink_to(path.absolute())
        yield copy


def _parts(folder: Path, suffix: str) -> list[Path]:
    return [path for part in (*PARTS, "rigs", "frames") if (path := folder / f"{part}{suffix}").is_file()]


def _unreadable(folder: Path, error: Exception) -> DatasetError:
    return DatasetError(f"{folder}: cannot be read as a COLMAP model ({error}); export it again")


def _not_finite(folder: Path) -> str | None:
    """`file:line` of the first nan or inf in a text model, which pycolmap's reader stops at without saying so."""
    for path in sorted(folder.glob("*.txt")):
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
            if not line.startswith("#") and {"nan", "inf"} & {word.lstrip("+-") for word in line.lower().split()}:
                return f"{path}:{number}"
    return None
