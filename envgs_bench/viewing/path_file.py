"""Camera paths from files: JSON as nerfstudio's viewer writes it, the frames of a transforms.json, or others.

    {"camera_path": [{"camera_to_world": [16 numbers, row by row], "fov": 60}, …],
     "render_width": 640, "render_height": 480}
    {"frames": [{"transform_matrix": [[4 numbers], …]}, …], "camera_angle_x": 1.1, "w": 640, "h": 480}

Matrices lead from the camera to the world, with OpenGL's axes (x right, y up, z backward), in the world of the run's
data set: nerfstudio turns and scales that of what it trains on unless it is told not to. `fov` is vertical, degrees;
intrinsics of frames are named as for `dataset=transforms`, but pictures need not be there, and lenses bend nothing.

    [{"position": [3 numbers], "rotation": [[3 numbers], …], "width": 640, "height": 480, "fx": 500, "fy": 500}, …]

is a cameras.json of 3DGS, as SuperSplat takes it: rotations lead from the camera, with our axes, to the world. A file
that ends in .chan has a line a frame, as Blender's add-on for Nuke's format writes it with "Z up" off: its number, x,
y, z, degrees about x, y and z in this order, and the vertical field of view, degrees.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, Placement
from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.formats.transforms_json import FrameFile, read_json
from envgs_bench.regular_file import read_regular_text

CHAN = ".chan"
MOST_BYTES = 100_000_000
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # from our camera axes to OpenGL's
CAMERAS_JSON = {"width": "w", "height": "h", "fx": "fl_x", "fy": "fl_y"}  # 3DGS's names -> a transforms.json's
PERSPECTIVE = "perspective"  # nerfstudio's name of the one camera_type that is drawn
LARGEST_EDGE = 16_384  # pixels
EXPECTED = 'expected {"camera_path": [{"camera_to_world": […], "fov": …}, …]} or {"frames": [{"transform_matrix": …}]}'


def read_path(path: Path, like: Camera, placement: Placement) -> list[Camera]:
    """The file's cameras, each a frame; size and focal length are those of `like` where the file does not say.

    Args:
        placement: of the run's scene; the file is in the data's coordinates, the cameras are in the scene's world.

    Raises:
        DatasetError: there is no such file, or it holds no cameras; the message names it and the frame.
    """
    content = _of_lines(path) if path.suffix.lower() == CHAN else read_json(path)
    if isinstance(content, list):
        content = {"frames": [_of_cameras_json(entry, path, index) for index, entry in enumerate(content)]}
    nerfstudio = isinstance(content, dict) and "camera_path" in content
    frames = content.get("camera_path" if nerfstudio else "frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise DatasetError(f"{path}: holds no camera path; {EXPECTED}")
    if nerfstudio:
        _require_perspective(content, frames, path)
        content = {"w": content.get("render_width"), "h": content.get("render_height")}
        frames = [_as_frame(frame, path, index) for index, frame in enumerate(frames)]
    file = FrameFile(path, content, frames)
    cameras = [_camera(file, frame, f"frame {index}", like, placement) for index, frame in enumerate(frames)]
    file.note_scales()
    return cameras


def _of_cameras_json(entry: Any, path: Path, index: int) -> dict[str, Any]:
    """An entry of 3DGS's cameras.json with the names of a transforms.json."""
    try:
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(entry["rotation"], np.float64).reshape(3, 3)
        matrix[:3, 3] = np.asarray(entry["position"], np.float64).reshape(3)
        known = {ours: float(entry[theirs]) for theirs, ours in CAMERAS_JSON.items() if theirs in entry}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: frame {index} is no camera of a cameras.json ({error!r}); {EXPECTED}") from error
    return {**known, "transform_matrix": (matrix @ OPENGL).tolist()}


def _of_lines(path: Path) -> dict[str, Any]:
    """The frames of a .chan file, with the names of a transforms.json."""
    frames = []
    try:
        lines = read_regular_text(path, MOST_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read ({error})") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            _, *values = map(float, line.split())
            place, angles, *fov = np.array(values[:3]), values[3:6], *values[6:7]
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
            matrix[:3, 3] = place
        except ValueError as error:
            raise DatasetError(
                f"{path}: line {number} is no camera ({error}); expected a frame's number, x, y, z, three angles and "
                "the vertical field of view, degrees"
            ) from error
        frames.append(
            {"transform_matrix": matrix.tolist(), **({"camera_angle_y": math.radians(fov[0])} if fov else {})}
        )
    return {"frames": frames}


def _require_perspective(content: dict[str, Any], frames: list[dict[str, Any]], path: Path) -> None:
    """Refuse a panorama's path, or a fisheye's: pictures are drawn in perspective alone."""
    for owner in (content, *frames):
        kind = owner.get("camera_type") or PERSPECTIVE
        if str(kind).lower() != PERSPECTIVE:
            raise DatasetError(
                f"{path}: camera_type={repr(kind)[:60]}, of which no picture can be drawn; expected {PERSPECTIVE!r}: "
                "export the path with perspective cameras"
            )


def _as_frame(entry: dict[str, Any], path: Path, index: int) -> dict[str, Any]:
    """An entry of nerfstudio's path with the names of a transforms.json."""
    try:
        matrix = np.asarray(entry["camera_to_world"], dtype=np.float64).reshape(-1, 4).tolist()
        angle = math.radians(float(entry["fov"])) if "fov" in entry else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: frame {index} is no camera ({error!r}); {EXPECTED}") from error
    return {"transform_matrix": matrix, "camera_angle_y": angle}


def _camera(file: FrameFile, frame: dict[str, Any], name: str, like: Camera, placement: Placement) -> Camera:
    model, _ = file.distortion(frame)
    if model == "OPENCV_FISHEYE":
        raise DatasetError(
            f"{file.path}: {name} has a fisheye camera, of which no picture can be drawn; give it camera_model=PINHOLE "
            "and the focal lengths of a perspective picture"
        )
    width = round(file.within("w", frame, 1, LARGEST_EDGE) or like.width)
    height = round(file.within("h", frame, 1, LARGEST_EDGE) or like.height)
    fx, fy = file.focal("x", frame, width), file.focal("y", frame, height)
    if fx is None and fy is None:
        fx = fy = float(like.intrinsics[1, 1]) * height / like.height
    cx, cy = file.number("cx", frame), file.number("cy", frame)
    intrinsics = [
        [fx or fy, 0.0, width / 2 if cx is None else cx],
        [0.0, fy or fx, height / 2 if cy is None else cy],
        [0.0, 0.0, 1.0],
    ]
    try:
        pose = torch.from_numpy(placement.pose_from_data(file.pose(frame, name))).float()
        return Camera(pose, torch.tensor(intrinsics), width, height)
    except DatasetError:
        raise
    except ValueError as error:
        raise DatasetError(f"{file.path}: {name} is no camera: {error}") from error
