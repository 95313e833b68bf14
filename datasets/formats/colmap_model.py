"""Models: what COLMAP knows of a capture, read by pycolmap from text or binary files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from envgs_bench.regular_file import require_regular

from ..errors import DatasetError
from .colmap_binary import check_sizes, image_names
from .names import path_below
from .photograph import LONGEST_EDGE, Photograph
from .point_clouds import PointCloud, point_cloud
from .siblings import Siblings

PARTS = ("cameras", "images", "points3D")


@dataclass(frozen=True)
class Observations:
    """Where one image shows points of the model."""

    positions: NDArray[np.float64]  # [K, 2] x, y in pixels of the image that the model was made from
    points: NDArray[np.int64]  # [K] which points


@dataclass(frozen=True)
class Model:
    """Cameras, images and points3D, as .bin or .txt, in one folder."""

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
        return _read(self.folder)

    @property
    def files(self) -> list[Path]:
        """The files that pycolmap reads of it."""
        parts = (*PARTS, "rigs", "frames")
        return [path for part in parts if (path := self.folder / f"{part}{self._suffix}").is_file()]

    def listed_images(self) -> list[str]:
        """The names of all images, also of those without a pose; points and observations are not read.

        Raises:
            DatasetError: it cannot be read.
        """
        path = self.folder / f"images{self._suffix}"
        try:
            return image_names(path) if path.suffix == ".bin" else _names_in_text(path)
        except (OSError, ValueError, IndexError):
            return [image.name for image in self.content.images.values()]  # or pycolmap says what is wrong

    @property
    def _suffix(self) -> str:
        """What pycolmap reads: text where a binary file is missing."""
        return ".bin" if all((self.folder / f"{part}.bin").exists() for part in PARTS) else ".txt"

    @property
    def image_names(self) -> list[str]:
        """The images that have a pose, sorted: paths below the images' folder."""
        return sorted(image.name for image in self.content.images.values() if image.has_pose)

    def points(self) -> PointCloud:
        """The triangulated points; raises as `point_cloud`."""
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
        by_stem = Siblings(images)
        found, missing = [], []
        for image in registered:
            named = path_below(images, image.name, self.folder)
            path = named if named.is_file() else by_stem.find(image.name)
            if path is None:
                missing.append(image.name)
                continue
            camera = cameras[image.camera_id]
            self._check_size(camera, image.name)
            self._check_finite(f"camera {image.camera_id}", camera.params, image.name)
            found.append(Photograph(image.name, path, camera, str(image.camera_id), self._pose(image)))
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


def _read(folder: Path) -> pycolmap.Reconstruction:
    try:
        for path in (*folder.glob("*.txt"), *folder.glob("*.bin")):
            require_regular(path)
        if Model(folder)._suffix == ".bin":
            check_sizes(folder)
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error) from error
    try:
        model = pycolmap.Reconstruction(str(folder))
        for image in model.images.values():
            image.name.encode()  # pycolmap decodes names when they are asked for
        return model
    except Exception as error:  # pycolmap raises whatever its C++ does
        odd = _not_finite(folder)
        if odd:
            raise DatasetError(f"{odd}: this line holds a number that is not finite; repair or remove it") from error
        raise _unreadable(folder, error) from error


def _unreadable(folder: Path, error: Exception) -> DatasetError:
    return DatasetError(f"{folder}: cannot be read as a COLMAP model ({error}); export it again")


def _names_in_text(path: Path) -> list[str]:
    """The names in an images.txt: the tenth word of a line; the line after it, which may be empty, lists points."""
    require_regular(path)
    names = []
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            if line.strip() and not line.startswith("#"):
                names.append(line.split()[9])
                next(lines, None)
    return names


def _not_finite(folder: Path) -> str | None:
    """`file:line` of the first nan or inf in a text model, which pycolmap's reader stops at without saying so."""
    for path in sorted(folder.glob("*.txt")):
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
            if not line.startswith("#") and {"nan", "inf"} & {word.lstrip("+-") for word in line.lower().split()}:
                return f"{path}:{number}"
    return None
