"""COLMAP's binary models, measured without reading: pycolmap believes their counts, and reads zeros past their end."""

from __future__ import annotations

import mmap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from struct import Struct
from struct import error as StructError

import pycolmap

from envgs_bench.regular_file import require_regular

COUNT = Struct("<Q")
CAMERA = Struct("<IiQQ")  # id, model, width, height; then its parameters, doubles
IMAGE = Struct("<I7dI")  # id, pose, camera; then its name, a zero, and a count of points
POINT2D = Struct("<2dQ")
POINT3D = Struct("<Q3d3BdQ")  # id, place, color, error, length of its track
OBSERVATION = Struct("<II")
SENSOR = Struct("<iI")  # type, id
POSE = Struct("<7d")
FRAME = Struct("<II7dI")  # id, rig, pose, count of data
DATUM = Struct("<iIQ")

Content = mmap.mmap
Step = Callable[[Content, int], int]  # where the entry that begins there ends


def check_sizes(folder: Path) -> None:
    """Whether each binary file of the model ends where its counts say.

    Raises:
        OSError: one is no regular file, or cannot be read.
        ValueError: one is cut short, or too long; the message names it.
    """
    for name, step in STEPS.items():
        if (folder / name).exists():
            _walk(folder / name, step)


def image_names(path: Path) -> list[str]:
    """The names in an images.bin; the points that the images show are stepped over.

    Raises:
        OSError, ValueError: it is no such file, or not a whole one.
    """
    names: list[str] = []

    def named(content: Content, at: int) -> int:
        end = _image(content, at)
        names.append(content[at + IMAGE.size : content.find(b"\0", at + IMAGE.size)].decode())
        return end

    _walk(path, named)
    return names


def _walk(path: Path, step: Step) -> None:
    size = require_regular(path)
    if size < COUNT.size:
        raise ValueError(f"{path.name} has {size} bytes, too few for its count")
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        (count,), at = COUNT.unpack_from(content), COUNT.size
        if count > size:
            raise ValueError(f"{path.name} promises {count} entries and has {size:,} bytes")
        for number in range(count):
            try:
                at = step(content, at)
            except StructError:
                at = size + 1
            if at > size:
                raise ValueError(f"{path.name} is cut short: it ends within entry {number + 1} of {count}")
        if at < size:
            raise ValueError(f"{path.name} holds {size - at:,} bytes behind its {count} entries")


def _camera(content: Content, at: int) -> int:
    _, model, _, _ = CAMERA.unpack_from(content, at)
    return at + CAMERA.size + 8 * _parameters(model)


def _image(content: Content, at: int) -> int:
    end = content.find(b"\0", at + IMAGE.size)
    if end < 0:
        return len(content) + 1
    return end + 1 + COUNT.size + POINT2D.size * COUNT.unpack_from(content, end + 1)[0]


def _point(content: Content, at: int) -> int:
    return at + POINT3D.size + OBSERVATION.size * POINT3D.unpack_from(content, at)[-1]


def _rig(content: Content, at: int) -> int:
    _, sensors = OBSERVATION.unpack_from(content, at)
    at += OBSERVATION.size
    if not sensors:
        return at
    if sensors > len(content):
        return len(content) + 1
    at += SENSOR.size  # the first is the rig's reference and has no pose
    for _ in range(sensors - 1):
        at += SENSOR.size
        at += 1 + POSE.size * (content[at] != 0 if at < len(content) else 0)
    return at


def _frame(content: Content, at: int) -> int:
    return at + FRAME.size + DATUM.size * FRAME.unpack_from(content, at)[-1]


STEPS = {
    "cameras.bin": _camera,
    "images.bin": _image,
    "points3D.bin": _point,
    "rigs.bin": _rig,
    "frames.bin": _frame,
}


@cache
def _parameters(model: int) -> int:
    """How many numbers a camera of the model has. Raises ValueError where COLMAP knows no such model."""
    if model not in {int(known) for known in pycolmap.CameraModelId.__members__.values()} - {-1}:
        raise ValueError(f"cameras.bin names the camera model {model}, which pycolmap does not know")
    return len(pycolmap.Camera.create_from_model_id(0, pycolmap.CameraModelId(model), 1.0, 1, 1).params)
