"""Frames: the JSON files of posed images that NeRF's blender scenes, instant-ngp and nerfstudio share."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from envgs_bench.regular_file import require_regular

from ..consistency.frames import check_frame, check_size_stated
from ..errors import DatasetError, listed
from ..notes import note
from .image_files import ImageFiles
from .names import clean_name, path_below, stem_of
from .photograph import LONGEST_EDGE, Photograph
from .pictures import read_header

FLAT_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
FISHEYE_MODELS = ("OPENCV_FISHEYE", "FISHEYE")
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y")
MOST_BYTES = 500_000_000  # of such a file; a frame takes a thousand
ORTHONORMAL = 1e-3  # error of a rotation, of its length and of its right angles: three decimals leave as much
EXACT = 1e-6  # and as much is left alone; what errs more becomes the nearest rotation, as `Camera` wants it
LARGEST = 1e15  # no number in such a file is meant to be larger
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class FrameFile:
    """A transforms.json: what holds for all frames, and the frames."""

    path: Path
    shared: dict[str, Any]
    frames: list[dict[str, Any]]
    scales: list[float] = field(default_factory=list)  # found in the matrices whose poses were asked for

    @property
    def root(self) -> Path:
        return self.path.parent

    def photographs(self, images: str | None = None) -> tuple[list[Photograph], list[str]]:
        """The photographs in the file's order, and the names of those that are not there.

        Args:
            images: a folder below the file's that stands for the first folder of each name, as one of reduced copies.

        Raises:
            DatasetError: a frame without name, pose or focal length, of an unknown camera model, or with a name that
                leaves the folder.
        """
        found, missing = [], []
        names = [self._name(frame, index) for index, frame in enumerate(self.frames)]
        places = [_in_folder(name, images) if images else name for name in names]
        files = ImageFiles(self.root, places, self.path)
        for index, (frame, name, place) in enumerate(zip(self.frames, names, places, strict=True)):
            path = files.find(place)
            if path is None:
                missing.append(name)
                continue
            own = any(key in frame for key in INTRINSICS)
            camera_id = f"{self.path.name}, frame {index}" if own else self.path.name
            name = stem_of(name)
            camera, pose = self._camera(frame, path, images), self.pose(frame, name)
            found.append(Photograph(name + path.suffix, path, camera, camera_id, pose, self._masks(frame)))
        self.note_scales()
        files.note_converted()
        without = [photograph.name for photograph in found if not photograph.masks]
        if 0 < len(without) < len(found):
            raise DatasetError(f"{self.path}: gives a mask_path for some frames only; add one for {listed(without)}")
        return found, missing

    def number(self, key: str, frame: dict[str, Any]) -> float | None:
        """A number of the frame, or else of all frames; None where neither has it."""
        value = frame.get(key, self.shared.get(key))
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
            raise DatasetError(f"{self.path}: {key}={repr(value)[:60]}, expected a finite number")
        return float(value)

    def within(self, key: str, frame: dict[str, Any], least: float, most: float) -> float | None:
        """As `number`, from `least` to `most`."""
        value = self.number(key, frame)
        if value is not None and not least <= value <= most:
            raise DatasetError(f"{self.path}: {key}={value:g}, expected a number from {least:g} to {most:,g}")
        return value

    def pose(self, frame: dict[str, Any], name: str) -> NDArray[np.float64]:
        """World to camera [4, 4], OpenCV axes, of the frame's camera to world, OpenGL axes; errors say `name`."""
        try:
            matrix = np.asarray(frame.get("transform_matrix"), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            matrix = np.empty(0)
        if matrix.shape == (3, 4):
            matrix = np.concatenate([matrix, [[0, 0, 0, 1]]])
        if matrix.shape != (4, 4) or not (np.abs(matrix) <= LARGEST).all() or np.linalg.det(matrix) == 0:
            raise DatasetError(
                f"{self.path}: the transform_matrix of {name} is no camera-to-world matrix of 4×4 finite numbers"
            )
        return np.asarray(np.linalg.inv(self._unscaled(matrix, name) @ OPENGL_TO_OPENCV), dtype=np.float64)

    def note_scales(self) -> None:
        """Note that matrices whose poses were asked for had a scale of the camera in them."""
        if self.scales:
            low, high = min(self.scales), max(self.scales)
            scale = f"{low:.4g}" if math.isclose(low, high, rel_tol=ORTHONORMAL) else f"{low:.4g} to {high:.4g}"
            note(
                f"{self.path}: the transform_matrix of {len(self.scales)} frames scales its camera by {scale}; "
                "the rotations are divided by it, as instant-ngp does, and the places stay"
            )

    def _unscaled(self, matrix: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        """The matrix [4, 4] with a rotation, the nearest, and without the one scale that may multiply it.

        Raises:
            DatasetError: it mirrors, skews, stretches axes differently, or its last row is not (0, 0, 0, w).
        """
        axes, last = matrix[:3, :3], matrix[3]
        scale = abs(float(np.linalg.det(axes))) ** (1 / 3)
        whole = scale > 0 and np.allclose(axes.T @ axes / scale**2, np.eye(3), atol=ORTHONORMAL)
        what = f"{self.path}: the transform_matrix of {name}"
        if not whole or last[:3].any() or last[3] != 1:
            lengths = ", ".join(f"{length:.4g}" for length in np.linalg.norm(axes, axis=0))
            raise DatasetError(
                f"{what} is no rotation with a place, perhaps scaled as a whole: its axes have the lengths {lengths}, "
                f"its last row is {', '.join(f'{value:g}' for value in last)}; expected axes of one length at right "
                "angles, and 0, 0, 0, 1; export it without skew and perspective"
            )
        if np.linalg.det(axes) < 0:
            raise DatasetError(
                f"{what} mirrors its camera (its determinant is below 0); export it with right-handed axes"
            )
        if abs(scale - 1) > ORTHONORMAL:
            self.scales.append(scale)
            axes = axes / scale
        if not np.allclose(axes.T @ axes, np.eye(3), rtol=0, atol=EXACT):
            left, _, right = np.linalg.svd(axes)
            axes = left @ right
        return np.concatenate([np.concatenate([axes, matrix[:3, 3:]], axis=1), matrix[3:]])

    def focal(self, axis: str, frame: dict[str, Any], length: float) -> float | None:
        """In pixels: fl_<axis>, or of the whole field of view camera_angle_<axis>; the frame's own first."""
        focal, angle = self.number(f"fl_{axis}", frame), self.number(f"camera_angle_{axis}", frame)
        own_angle = f"camera_angle_{axis}" in frame and f"fl_{axis}" not in frame
        if angle is not None and (focal is None or own_angle):
            if not 0 < angle < math.pi:
                raise DatasetError(f"{self.path}: camera_angle_{axis}={angle:g}, expected radians between 0 and π")
            focal = length / 2 / math.tan(angle / 2)
        if focal is not None and focal <= 0:
            raise DatasetError(
                f"{self.path}: has a focal length of {focal:g} pixels in {axis}, expected a positive one"
            )
        return focal

    def _name(self, frame: dict[str, Any], index: int) -> str:
        if not isinstance(frame.get("file_path"), str):
            raise DatasetError(f"{self.path}: frame {index} has no file_path; add the image's path below {self.root}")
        return clean_name(frame["file_path"], self.path)

    def _masks(self, frame: dict[str, Any]) -> dict[str, Path]:
        named = frame.get("mask_path") or self.shared.get("mask_path")
        if not named:
            return {}
        path = path_below(self.root, str(named), self.path)
        if not path.is_file():
            raise DatasetError(f"{self.path}: names the mask {path}, which is not there; add it, or drop mask_path")
        return {"foreground": path}

    def _camera(self, frame: dict[str, Any], path: Path, images: str | None) -> pycolmap.Camera:
        width, height = (self.within(edge, frame, 1, LONGEST_EDGE) for edge in ("w", "h"))
        unknown = width is None or height is None
        if width is None or height is None:
            header = read_header(path)
            width, height = header.width, header.height
        fx = self.focal("x", frame, width)
        if fx is None:
            raise DatasetError(
                f"{self.path}: gives no focal length for {path.name}: neither fl_x, pixels, nor camera_angle_x, radians"
            )
        check_frame(self.path, self.shared, frame)
        if unknown:
            check_size_stated(self.path, {**self.shared, **frame}, round(width), round(height), images is not None)
        fy = self.focal("y", frame, height) or fx
        cx, cy = self.number("cx", frame), self.number("cy", frame)
        center = [width / 2 if cx is None else cx, height / 2 if cy is None else cy]
        model, distortion = self.distortion(frame)
        return pycolmap.Camera(
            model=model, width=round(width), height=round(height), params=[fx, fy, *center, *distortion]
        )

    def distortion(self, frame: dict[str, Any]) -> tuple[str, list[float]]:
        """pycolmap's camera model and its parameters after focal lengths and principal point."""
        named = frame.get("camera_model", self.shared.get("camera_model", "OPENCV"))
        k1, k2, k3, k4, p1, p2 = (self.number(key, frame) or 0.0 for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
        if named in FISHEYE_MODELS or frame.get("is_fisheye", self.shared.get("is_fisheye")):
            return "OPENCV_FISHEYE", [k1, k2, k3, k4]
        if named not in FLAT_MODELS or k4:
            what = (
                f"camera_model={repr(named)[:60]}" if named not in FLAT_MODELS else f"k4={k4:g} without a fisheye model"
            )
            known = ", ".join(FLAT_MODELS + FISHEYE_MODELS)
            raise DatasetError(
                f"{self.path}: {what} is not supported; the models are {known}; undistort the images first"
            )
        if k3:
            return "FULL_OPENCV", [k1, k2, p1, p2, k3, 0, 0, 0]
        return ("OPENCV", [k1, k2, p1, p2]) if any((k1, k2, p1, p2)) else ("PINHOLE", [])


def read_frames(path: Path) -> FrameFile:
    """The frames that a JSON file lists.

    Raises:
        DatasetError: there is no such file, it is no JSON, or it lists no frames.
    """
    content = read_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise DatasetError(f'{path}: lists no frames, expected an object with "frames": [{{"file_path": …}}, …]')
    return FrameFile(path, content, frames)


def read_json(path: Path) -> Any:
    """What the JSON file holds. Raises DatasetError where there is no such file, or it is no JSON."""
    try:
        require_regular(path, MOST_BYTES)
        return json.loads(path.read_bytes())  # in UTF-8, -16 or -32, with a byte order mark or without
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: there is no such file") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: cannot be read as JSON ({error}); export it again") from error


def without_common_folder(names: Sequence[str]) -> list[str]:
    """The names below the deepest folder that holds them all."""
    parents = [PurePosixPath(name).parent.parts for name in names]
    depth = 0
    while parents and all(len(parts) > depth and parts[depth] == parents[0][depth] for parts in parents):
        depth += 1
    return [PurePosixPath(*PurePosixPath(name).parts[depth:]).as_posix() for name in names]


def _in_folder(name: str, images: str) -> str:
    return PurePosixPath(images, *(PurePosixPath(name).parts[1:] or [name])).as_posix()
