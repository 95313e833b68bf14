"""Frame time: how long a method takes from a camera to an image on its device, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from envgs_bench.core import Camera, View
from envgs_bench.methods.method import Method
from envgs_bench.records import Timing, ViewTimes
from envgs_bench.settings import TimingSettings

from .stopwatch import time_calls

FRAMES_QUEUED = 3  # on a GPU: enough that the device never waits for the host


@dataclass(frozen=True)
class FrameTimes:
    """Every timed frame of every view, ms, and what a scene's numbers are made of."""

    times_ms: list[list[float]]  # one list a view

    @property
    def frame_ms(self) -> float:
        """The mean over views of each view's median: medians forgive hiccups, views count alike."""
        return float(np.mean([np.median(times) for times in self.times_ms]))

    @property
    def frame_ms_p95(self) -> float:
        """The 95th percentile of all frames of all views: hard views and hiccups both show."""
        return float(np.percentile(np.concatenate(self.times_ms), 95))

    @property
    def fps(self) -> float:
        """1000 / frame_ms, not a mean of frame rates: that would favor views that are fast already."""
        return 1000 / self.frame_ms


def time_frames(method: Method, views: Sequence[View], settings: TimingSettings) -> Timing:
    """The timing of a trained method's pictures of `views`; `Method.prepare` is timed apart, once.

    Raises:
        ValueError: there are no views.
    """
    if not views:
        raise ValueError("there are no views to time: the data set has no test views")
    device = method.device
    cameras = [view.camera.to(device) for view in views]
    prepare_ms = time_calls(method.prepare, device, 1, float("inf"))[0]
    frames = time_views(method.picture, cameras, device, settings.frames, settings.seconds)
    return Timing(
        frame_ms=frames.frame_ms,
        frame_ms_p95=frames.frame_ms_p95,
        fps=frames.fps,
        prepare_ms=prepare_ms,
        height=cameras[0].height,
        width=cameras[0].width,
        per_view=[
            ViewTimes(view=view.name, times_ms=times) for view, times in zip(views, frames.times_ms, strict=True)
        ],
        contract=contract(cameras, device, settings.frames, settings.seconds),
    )


def time_views(
    render: Callable[[Camera], Any],
    cameras: Sequence[Camera],
    device: torch.device | str,
    frames: int = 50,
    seconds: float = 1.0,
) -> FrameTimes:
    """Time `render(camera)` for each camera: frames to warm up, then until either limit is reached.

    On a GPU each frame lies between two device events and up to FRAMES_QUEUED are under way at once, so that launching
    overlaps drawing; on a CPU `perf_counter` is read before and after each frame.

    Args:
        render: camera to an image on the device; it must not cache images.
        cameras: on the device already.
        frames: most frames a view, at least 1.
        seconds: no frame of a view is begun after this time, but for the first.
    """
    device = torch.device(device)
    times = []
    for camera in cameras:
        for _ in range(_warm_up(device)):
            render(camera)
        times.append(time_calls(partial(render, camera), device, frames, seconds, queued=FRAMES_QUEUED))
    return FrameTimes(times)


def _warm_up(device: torch.device) -> int:
    """Frames of a view that are not timed: a GPU's first compiles kernels, its second records what is replayed."""
    return FRAMES_QUEUED if device.type == "cuda" else 1


def contract(cameras: Sequence[Camera], device: torch.device | str, frames: int, seconds: float) -> str:
    """What the numbers mean, in words for the record."""
    queued = f"device events, {FRAMES_QUEUED} frames queued, synchronized once a view"
    device = torch.device(device)
    clock = queued if device.type == "cuda" else "perf_counter"
    warmed_up = "warmed up once" if _warm_up(device) == 1 else f"warmed up by {_warm_up(device)} frames"
    sizes = {(camera.width, camera.height) for camera in cameras}
    size = " ".join(f"{width}×{height}" for width, height in sorted(sizes))
    return (
        f"camera to image on the device at {size} px, acceleration structures excluded; {len(cameras)} views, each "
        f"{warmed_up}, then {frames} frames or {seconds:g} s, whichever ends first; {clock}; frame_ms is the mean "
        "of per-view medians, frame_ms_p95 the 95th percentile of all frames, fps 1000 / frame_ms"
    )
