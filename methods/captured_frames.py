"""CapturedFrames: the kernels of a picture recorded once as a CUDA graph, and replayed for other cameras of its size.

A small picture is some dozens of kernels, which Python launches more slowly than they run. As of a recorded step,
nobody can look into a graph that runs: a picture that had too little room for its lists is NaN, and is drawn again as
it would have been without a graph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Statistics

from .recording import on_own_stream, own_camera, recorded


class CapturedFrames:
    """Draws pictures: the first of a size one kernel after the other, those that follow it from a graph.

    One thread at a time: all of them would share a graph's camera.

    Args:
        draw: all of a picture's work on the device, from a camera that is there. It must not wait for the device.
        device: a GPU.
    """

    def __init__(self, draw: Callable[[Camera], Rendering], device: torch.device) -> None:
        self._draw, self._device = draw, device
        self._size: tuple[int, int] | None = None  # of the latest picture that was drawn without a graph
        self._graph: _Graph | None = None

    def forget(self) -> None:
        """What is drawn has changed: give back the memory that a graph holds."""
        self._size = self._graph = None

    def draw(self, camera: Camera) -> Rendering:
        """The picture as `draw` draws it, in tensors of its own."""
        size = camera.width, camera.height
        with on_own_stream(self._device):
            if self._size == size:
                if self._graph is None:
                    self._graph = _Graph(self._draw, camera.to(self._device))
                rendering = self._graph.replay(camera)
                if rendering is not None:
                    return rendering
            self._size, self._graph = size, None  # kernels are compiled, and lists get their room
            return self._draw(camera.to(self._device))


class _Graph:
    """One recording of `draw`, with its own copy of a camera to read."""

    def __init__(self, draw: Callable[[Camera], Rendering], camera: Camera) -> None:
        self._camera = own_camera(camera)
        self._graph, (self._rendering, self._sample) = recorded(lambda: self._sampled_picture(draw), camera.device)
        self._sampled = torch.empty(self._sample.shape, pin_memory=True)
        self._arrived = torch.cuda.Event()

    def _sampled_picture(self, draw: Callable[[Camera], Rendering]) -> tuple[Rendering, Tensor]:
        rendering = draw(self._camera)
        return rendering, torch.cat([rendering.color[0, 0], rendering.alpha[0, :1]])

    def replay(self, camera: Camera) -> Rendering | None:
        """The picture, None where there was too little room: all of it is NaN then, so one pixel tells."""
        self._camera.world_to_camera.copy_(camera.world_to_camera, non_blocking=True)
        self._camera.intrinsics.copy_(camera.intrinsics, non_blocking=True)
        self._graph.replay()
        self._sampled.copy_(self._sample, non_blocking=True)
        self._arrived.record()
        drawn = self._rendering
        copied = replace(
            drawn.map(Tensor.clone),
            statistics=Statistics(drawn.statistics.weights.clone()),
            layers={name: layer.clone() for name, layer in drawn.layers.items()},
        )
        self._arrived.synchronize()  # copies are under way meanwhile
        return copied if bool(self._sampled.isfinite().all()) else None
