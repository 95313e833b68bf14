"""Twins: a COLMAP model that lies in one folder as text and as binary files, which must say the same."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pycolmap

from ..errors import DatasetError
from ..formats.colmap_model import PARTS

RELATIVE = 1e-4  # of numbers that agree: some programs write few digits


def check_twins(folder: Path, model: pycolmap.Reconstruction) -> None:
    """Refuse a model read from binary files where text files beside them state other cameras or poses.

    Raises:
        DatasetError: they differ; which of them is meant, nobody can tell.
    """
    for name, differs in (("cameras", _cameras_differ), ("images", _poses_differ)):
        text = folder / f"{name}.txt"
        if not (text.is_file() and all((folder / f"{part}.bin").is_file() for part in PARTS)):
            continue  # where a binary file is missing, text is what was read
        try:
            what = differs(text, model)
        except (OSError, ValueError, IndexError) as error:
            raise DatasetError(f"{text}: cannot be read beside {name}.bin ({error}); remove it") from error
        if what:
            raise DatasetError(
                f"{folder}: {name}.txt and {name}.bin state different things of {what}; remove those files that are "
                "stale, the .txt or the .bin ones"
            )


def _cameras_differ(text: Path, model: pycolmap.Reconstruction) -> str | None:
    listed = {}
    for words in _lines(text):
        listed[int(words[0])] = (words[1], [float(word) for word in words[2:]])
    if set(listed) != set(model.cameras):
        return "which cameras there are"
    for key, camera in model.cameras.items():
        name, numbers = listed[key]
        own = [camera.width, camera.height, *camera.params]
        if name != camera.model.name or len(own) != len(numbers) or not _same(own, numbers):
            return f"camera {key}"
    return None


def _poses_differ(text: Path, model: pycolmap.Reconstruction) -> str | None:
    poses = {}
    lines = _lines(text, keep_empty=True)
    for words in lines:
        if words:
            poses[" ".join(words[9:])] = [float(word) for word in words[1:8]]
            next(lines, None)  # the points that it shows
    by_name = {image.name: image for image in model.images.values() if image.has_pose}
    if set(poses) != set(by_name):
        return "which images there are"
    for name, image in by_name.items():
        pose = image.cam_from_world()
        x, y, z, w = pose.rotation.quat
        own, given = np.array([w, x, y, z]), np.array(poses[name][:4])
        given = given / (np.linalg.norm(given) or 1.0)
        if abs(own @ given) < 1 - RELATIVE**2 or not _same(pose.translation, poses[name][4:]):
            return f"the pose of {name}"
    return None


def _same(ours: object, theirs: object) -> bool:
    a, b = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    return bool(np.abs(a - b).max() <= RELATIVE * max(1e-9, np.abs(a).max()))


def _lines(path: Path, keep_empty: bool = False) -> Iterator[list[str]]:
    """The words of each line that is no comment."""
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            if not line.startswith("#") and (keep_empty or line.strip()):
                yield line.split()
