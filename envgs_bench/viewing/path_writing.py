"""Camera paths as files of other programs: nerfstudio's, SuperSplat's, Blender's, and the frames of a transforms.json.

| format | file | what it is |
|---|---|---|
| transforms | .json | camera-to-world matrices with OpenGL's axes and all intrinsics, a frame each; lossless |
| nerfstudio | .json | the same matrices with the vertical field of view, as its viewer saves and loads them |
| supersplat | .json | cameras.json of 3DGS, which SuperSplat takes as keys of its timeline when it is dropped there |
| blender | .chan | Nuke's lines, which Blender's add-on reads: number, place, degrees about x, y, z, field of view |

All are in the coordinates of the data. `path_file.py` reads all of them again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, Placement
from envgs_bench.records import write_atomically

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # from OpenGL's camera axes to ours, and back

Array = NDArray[np.float64]


def write_path(path: Path, cameras: Sequence[Camera], placement: Placement, form: str, fps: float = 30.0) -> None:
    """Write the cameras, each a frame, in one of FORMATS.

    Raises:
        ValueError: the format is unknown, or the file's name ends otherwise than it does.
        OSError: the file cannot be written.
    """
    if form not in FORMATS:
        raise ValueError(f"format {form!r} is unknown: expected one of {', '.join(FORMATS)}")
    suffix, write = FORMATS[form]
    if path.suffix.lower() != suffix:
        raise ValueError(f"{path}: a camera path as {form} is a file that ends in {suffix}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, write(cameras, placement, fps))


def _to_world(camera: Camera, placement: Placement) -> Array:
    """Camera to the data's world [4, 4], with our axes."""
    pose = placement.pose_to_data(camera.world_to_camera.double().numpy())
    return np.asarray(np.linalg.inv(pose), np.float64)


def _field_of_view(camera: Camera) -> float:
    """Vertical, radians; of a principal point in the middle."""
    return 2 * math.atan(camera.height / 2 / float(camera.intrinsics[1, 1]))


def _transforms(cameras: Sequence[Camera], placement: Placement, fps: float) -> str:
    frames = []
    for camera in cameras:
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.double().tolist()
        size = {"w": camera.width, "h": camera.height}
        matrix = (_to_world(camera, placement) @ OPENGL).tolist()
        frames.append({**size, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "transform_matrix": matrix})
    return json.dumps({"fps": fps, "frames": frames}, indent=1)


def _nerfstudio(cameras: Sequence[Camera], placement: Placement, fps: float) -> str:
    entries = []
    for camera in cameras:
        matrix = (_to_world(camera, placement) @ OPENGL).reshape(-1).tolist()
        fov = math.degrees(_field_of_view(camera))
        entries.append({"camera_to_world": matrix, "fov": fov, "aspect": camera.width / camera.height})
    content: dict[str, Any] = {
        **{"camera_type": "perspective", "render_width": cameras[0].width, "render_height": cameras[0].height},
        **{"fps": fps, "seconds": len(cameras) / fps, "smoothness_value": 0, "is_cycle": False},
        **{"keyframes": [], "crop": None, "camera_path": entries},
    }
    return json.dumps(content, indent=1)


def _supersplat(cameras: Sequence[Camera], placement: Placement, fps: float) -> str:
    entries = []
    for number, camera in enumerate(cameras):
        matrix = _to_world(camera, placement)
        entries.append(
            {
                **{"id": number, "img_name": f"frame_{number:05d}", "width": camera.width, "height": camera.height},
                **{"position": matrix[:3, 3].tolist(), "rotation": matrix[:3, :3].tolist()},
                **{"fx": float(camera.intrinsics[0, 0]), "fy": float(camera.intrinsics[1, 1])},
            }
        )
    return json.dumps(entries, indent=1)


def _blender(cameras: Sequence[Camera], placement: Placement, fps: float) -> str:
    lines = []
    for number, camera in enumerate(cameras, start=1):
        matrix = _to_world(camera, placement) @ OPENGL
        angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
        values = [*matrix[:3, 3], *angles, math.degrees(_field_of_view(camera))]
        lines.append("\t".join([str(number), *(f"{value:.9g}" for value in values)]))
    return "\n".join(lines) + "\n"


FORMATS: dict[str, tuple[str, Callable[[Sequence[Camera], Placement, float], str]]] = {
    "transforms": (".json", _transforms),
    "nerfstudio": (".json", _nerfstudio),
    "supersplat": (".json", _supersplat),
    "blender": (".chan", _blender),
}
