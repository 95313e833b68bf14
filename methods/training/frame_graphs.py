"""FrameGraphs: the kernels of a picture recorded once as a CUDA graph, and replayed for other cameras of its size.

A small picture is some dozens of kernels, which Python launches more slowly than they run. As of a step's CUDA graph,
nobody can look into a graph that runs: a picture that had too little room for its lists is NaN, and is drawn again as
it would have been without a graph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Statistics

from .cuda_graphs import on_own_stream, recorded

Drawn = TypeVar("Drawn")


@dataclass(frozen=True)
class Drawing(Generic[Drawn]):
    """What is drawn of a camera.

    Attributes:
        draw: all of the work on the device, from a camera that is there. It must not wait for the device.
        copy: what was drawn, in tensors of its own.
        pixel: values of one pixel of it, [K], NaN where there was too little room.
    """

    draw: Callable[[Camera], Drawn]
    copy: Callable[[Drawn], Drawn]
    pixel: Callable[[Drawn], Tensor]


class FrameGraphs(Generic[Drawn]):
    """Draws pictures: the first of a size one kernel after the other, those that follow it from a graph.

    One thread at a time: all of them would share a graph's camera.

    Args:
        drawing: what a picture is.
        device: a GPU.
    """

    def __init__(self, drawing: Drawing[Drawn], device: torch.device) -> None:
        self.drawing, self._device = drawing, device
        self._size: tuple[int, int] | None = None  # of the latest picture that was drawn without a graph
        self._graph: _Graph[Drawn] | None = None

    def forget(self) -> None:
        """What is drawn has changed: give back the memory that a graph holds."""
        self._size = self._graph = None

    def draw(self, camera: Camera) -> Drawn:
        """The picture as it is drawn without a graph, in tensors of its own."""
        size = camera.width, camera.height
        with on_own_stream(self._device):
            if self._size == size:
                if self._graph is None:
                    self._graph = _Graph(self.drawing, camera.to(self._device))
                drawn = self._graph.replay(camera)
                if drawn is not None:
                    return drawn
            self._size, self._graph = size, None  # kernels are compiled, and lists get their room
            return self.drawing.draw(camera.to(self._device))


class Pictures:
    """A method's images, from CUDA graphs where it `uses_graphs`: whole renderings, or their color alone."""

    def __init__(
        self,
        draw: Callable[[Camera], Rendering],
        draw_color: Callable[[Camera], Tensor],
        device: torch.device,
        uses_graphs: bool,
    ) -> None:
        self.uses_graphs = uses_graphs
        self._device = device
        self._renderings = FrameGraphs(rendering_drawing(draw), device)
        self._colors = FrameGraphs(color_drawing(draw_color), device)

    def forget(self) -> None:
        """What is drawn has changed."""
        self._renderings.forget()
        self._colors.forget()

    def rendering(self, camera: Camera) -> Rendering:
        return self._drawn(self._renderings, camera)

    def color(self, camera: Camera) -> Tensor:
        return self._drawn(self._colors, camera)

    def _drawn(self, frames: FrameGraphs[Drawn], camera: Camera) -> Drawn:
        return frames.draw(camera) if self.uses_graphs else frames.drawing.draw(camera.to(self._device))


class _Graph(Generic[Drawn]):
    """One recording of a drawing, with its own copy of a camera to read."""

    def __init__(self, drawing: Drawing[Drawn], camera: Camera) -> None:
        self._camera, self._copy = camera.clone(), drawing.copy

        def sampled() -> tuple[Drawn, Tensor]:
            drawn = drawing.draw(self._camera)
            return drawn, drawing.pixel(drawn)

        self._graph, (self._drawn, self._sample) = recorded(sampled, camera.device)
        self._sampled = torch.empty(self._sample.shape, pin_memory=True)
        self._arrived = torch.cuda.Event()

    def replay(self, camera: Camera) -> Drawn | None:
        """The picture, None where there was too little room: all of it is NaN then, so one pixel tells."""
        self._camera.world_to_camera.copy_(camera.world_to_camera, non_blocking=True)
        self._camera.intrinsics.copy_(camera.intrinsics, non_blocking=True)
        self._graph.replay()
        self._sampled.copy_(self._sample, non_blocking=True)
        self._arrived.record()
        copied = self._copy(self._drawn)
        self._arrived.synchronize()  # copies are under way meanwhile
        return copied if bool(self._sampled.isfinite().all()) else None


def rendering_drawing(draw: Callable[[Camera], Rendering]) -> Drawing[Rendering]:
    return Drawing(draw, _copied, lambda drawn: torch.cat([drawn.color[0, 0], drawn.alpha[0, :1]]))


def color_drawing(draw: Callable[[Camera], Tensor]) -> Drawing[Tensor]:
    """Of a color [H, W, 3] alone."""
    return Drawing(draw, Tensor.clone, lambda color: color[0, 0])


def _copied(drawn: Rendering) -> Rendering:
    return replace(
        drawn.map(Tensor.clone),
        statistics=Statistics(drawn.statistics.weights.clone()),
        layers={name: layer.clone() for name, layer in drawn.layers.items()},
    )
