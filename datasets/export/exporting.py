"""From a scene to a folder of files, whole or not at all."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envgs_bench.core import Scene

from ..errors import DatasetError
from .blender import write_blender
from .colmap import write_colmap

Writer = Callable[[Scene, Path], dict[str, Any]]

FORMATS: dict[str, Writer] = {
    "colmap": lambda scene, folder: write_colmap(scene, folder, text=False),
    "colmap-text": lambda scene, folder: write_colmap(scene, folder, text=True),
    "blender": write_blender,
}


def export_scene(scene: Scene, folder: Path, form: str) -> dict[str, Any]:
    """Write the scene as one of FORMATS into a new folder.

    Reading it back by the settings returned gives the same views, split, points, regions, background and normals to
    the last bit, cameras too (`rotation.exact_rotation` says when not; a world that was moved may be off by float64's
    last digits in the data's coordinates, which the files have). Depth has no place in these formats.

    Returns:
        what `load_scene` is to be given.

    Raises:
        DatasetError: there is something in the folder already, or the format cannot hold the scene.
        OSError: the folder cannot be written.
    """
    if form not in FORMATS:
        raise DatasetError(f"format {form!r} is unknown: expected one of {', '.join(FORMATS)}")
    if scene.val:
        raise DatasetError(f"{scene.name}: no format holds a validation split; export it with dataset.validation=false")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DatasetError(f"{folder}: is there already; give a new or an empty folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    part = folder.with_name(f"{folder.name}-{uuid.uuid4().hex[:8]}.part")
    try:
        settings = FORMATS[form](scene, part)
        part.replace(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    background = [float(channel) for channel in scene.background]
    unit = scene.placement.scale
    facts = {"free_space": scene.free_space * unit, "bounds": scene.bounds * unit}
    stated = {key: value for key, value in facts.items() if value}
    return {"root": str(folder.absolute()), "name": scene.name, "background": background, **stated, **settings}
