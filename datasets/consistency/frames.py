"""Frames: whether what a transforms.json states of one camera agrees with itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import DatasetError

OFF_CENTER = 0.1  # of an edge: a principal point farther from the middle needs a stated size
ANGLE_ERROR = 2e-3  # relative, of a focal length against its field of view: 0.1 pixel in 50
PAIRS = (("w", "h"), ("cx", "cy"))
DISTORTIONS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4")
# What each camera_model may have beside its pinhole; the flat ones of nerfstudio and instant-ngp mean OPENCV's.
OPENCV = ("k1", "k2", "k3", "p1", "p2")
FISHEYE = ("k1", "k2", "k3", "k4")
OF_MODEL = {
    "PINHOLE": (),
    "SIMPLE_PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": OPENCV,
    "PERSPECTIVE": OPENCV,
    "OPENCV_FISHEYE": FISHEYE,
    "FISHEYE": FISHEYE,
}


def check_frame(path: Path, shared: Mapping[str, Any], frame: Mapping[str, Any]) -> None:
    """Refuse a frame whose keys, its own or those of all frames, state two things of one.

    Raises:
        DatasetError: half a size or principal point, a focal length and a field of view that differ, a size without
            the focal length that holds for it, or a distortion that its camera model does not have.
    """
    stated = {**shared, **frame}
    name = frame.get("file_path")
    for pair in PAIRS:
        given = [key for key in pair if stated.get(key) is not None]
        if len(given) == 1:
            (other,) = set(pair) - set(given)
            raise DatasetError(f"{path}: gives {given[0]} and not {other} for {name}; add {other}")
    for source in (shared, frame):
        _check_angle(path, {**stated, **source} if source is frame else source, source, name)
    _check_own_size(path, shared, frame)
    _check_model(path, stated, name)


def check_size_stated(path: Path, frame: Mapping[str, Any], width: int, height: int, reduced: bool) -> None:
    """Refuse intrinsics in pixels of nobody knows which pictures.

    Args:
        frame: what holds for the frame: neither w nor h.
        width, height: of its file.
        reduced: another folder of images was chosen than the one that the file names.

    Raises:
        DatasetError: their principal point is not in the file's middle, or the file may be a reduced copy.
    """
    name = frame.get("file_path")
    remedy = "state w and h, the size that the numbers hold for: they are scaled to that of the files"
    if reduced and _numbers(frame, "fl_x"):
        raise DatasetError(f"{path}: gives fl_x for {name} and no size, and dataset.images names other files; {remedy}")
    if not _numbers(frame, "cx", "cy"):
        return
    across, down = frame["cx"] / width, frame["cy"] / height
    if max(abs(across - 0.5), abs(down - 0.5)) > OFF_CENTER:
        raise DatasetError(
            f"{path}: has its principal point (cx={frame['cx']:g}, cy={frame['cy']:g}) far from the middle of {name}, "
            f"which is {width}×{height} pixels, and gives no w and h; {remedy}"
        )


def _check_angle(path: Path, stated: Mapping[str, Any], source: Mapping[str, Any], name: Any) -> None:
    """A focal length and a field of view in one place are of one camera; of a fisheye's the latter is another thing."""
    if stated.get("is_fisheye") or "FISHEYE" in str(stated.get("camera_model")):
        return
    for axis, edge in (("x", "w"), ("y", "h")):
        keys = (f"fl_{axis}", f"camera_angle_{axis}")
        if not (_numbers(source, *keys) and _numbers(stated, edge)):
            continue
        focal, angle, length = source[keys[0]], source[keys[1]], stated[edge]
        if not 0 < angle < math.pi or focal <= 0:
            continue  # refused where they are read
        expected = length / 2 / math.tan(angle / 2)
        if abs(focal - expected) > ANGLE_ERROR * expected:
            raise DatasetError(
                f"{path}: {keys[0]}={focal:g} and {keys[1]}={angle:g} differ for {name or 'all frames'}: the latter is "
                f"a focal length of {expected:.5g} pixels at {edge}={length:g}; correct one of the three, or remove "
                f"{keys[1]}"
            )


def _check_own_size(path: Path, shared: Mapping[str, Any], frame: Mapping[str, Any]) -> None:
    if not (_numbers(shared, "w", "h", "fl_x") and _numbers(frame, "w", "h")):
        return
    same = frame["w"] == shared["w"] and frame["h"] == shared["h"]
    if not same and not {"fl_x", "camera_angle_x"} & frame.keys():
        raise DatasetError(
            f"{path}: {frame.get('file_path')} is {frame['w']:g}×{frame['h']:g} pixels of its own and has the focal "
            f"length of all frames, in pixels of {shared['w']:g}×{shared['h']:g}; add its own fl_x, fl_y, cx and cy"
        )


def _check_model(path: Path, stated: Mapping[str, Any], name: Any) -> None:
    model = stated.get("camera_model")
    fisheye = stated.get("is_fisheye")
    if isinstance(model, str) and isinstance(fisheye, bool) and fisheye != ("FISHEYE" in model) and model in OF_MODEL:
        raise DatasetError(
            f"{path}: camera_model={model} and is_fisheye={str(fisheye).lower()} contradict each other for {name}; "
            "remove the wrong one"
        )
    known = OF_MODEL.get("OPENCV_FISHEYE" if fisheye else str(model or "OPENCV"))
    if known is None:
        return  # refused where it is read
    odd = [key for key in DISTORTIONS if key not in known and _numbers(stated, key) and stated[key]]
    if odd and "k4" not in odd:
        raise DatasetError(
            f"{path}: {', '.join(f'{key}={stated[key]:g}' for key in odd)} for {name}, which camera_model="
            f"{model or ('OPENCV_FISHEYE' if fisheye else 'OPENCV')} does not have; name the model that it is of, or "
            "remove it"
        )


def _numbers(stated: Mapping[str, Any], *keys: str) -> bool:
    """Whether all are given, as numbers; what is none is refused where it is read."""
    values = [stated.get(key) for key in keys]
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
