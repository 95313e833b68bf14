"""Walk: a trained run along a camera path, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from envgs_bench.core import Camera

from .camera_paths import PATHS, interpolate, reframed
from .opened import OpenedRun, Picture, as_picture
from .path_file import read_path
from .sheets import side_by_side


@dataclass(frozen=True)
class Frame:
    picture: Picture  # the layers side by side
    milliseconds: float  # that drawing took


def cameras_along(run: OpenedRun, path: str, frames: int | None, size: tuple[int, int] | None) -> list[Camera]:
    """The cameras of a walk through the run's scene.

    Args:
        path: one of PATHS, or a file as of `read_path`.
        frames: how many; None: as many as the file has, which are otherwise gone through as by `interpolate`.
        size: (width, height), pixels; by default that of the first view, or what the file says.

    Raises:
        ValueError: the path cannot be read, or takes more cameras than there are.
    """
    cameras = run.cameras
    if path in PATHS:
        known = [view.camera for view in run.views] if path == "interpolate" and len(run.views) > 1 else cameras
        along = PATHS[path](known, frames or 1)
    elif Path(path).is_file():
        along = read_path(Path(path), cameras[0], run.scene.placement)
        along = along if frames is None else interpolate(along, frames)
    else:
        raise ValueError(f"--path {path}: is no file, and none of {', '.join(PATHS)}")
    return along if size is None else [reframed(camera, *size) for camera in along]


def walk(run: OpenedRun, cameras: Sequence[Camera], layers: Sequence[str]) -> Iterator[Frame]:
    """A frame a camera.

    Raises:
        ValueError: the method draws no such layer; the message names those that it does.
    """
    for camera in cameras:
        began = perf_counter()
        drawn = run.draw(camera)
        milliseconds = 1000 * (perf_counter() - began)
        if unknown := [name for name in layers if name not in drawn]:
            raise ValueError(f"--layers: {run.label} draws no {', '.join(unknown)}; its layers are {', '.join(drawn)}")
        yield Frame(side_by_side({name: as_picture(drawn[name]) for name in layers}), milliseconds)
