"""StepGraphs: a training step's work on a GPU recorded once as a CUDA graph, and replayed while only values change.

A step of a small scene is hundreds of kernels of a few microseconds, and Python launches them more slowly than they
run. A graph is launched at once. It holds addresses and sizes, so it lasts until a set grows or the method does
something else in a step; a densification is followed by another recording, which takes as long as a step without one.

Nobody can look into a graph that runs: an image that had too little room for its lists is NaN, which no optimizer
applies, and the step is taken again as it would have been without a graph.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, replace
from operator import is_

import torch
from torch import Tensor

from envgs_bench.core import View

from .cuda_graphs import on_own_stream, own_camera, recorded

IN_FLIGHT = 1  # steps that the device may be behind when another is launched: it then never waits for the host


@dataclass(frozen=True)
class StepNumbers:
    """What a training step tells of itself, on the device.

    Attributes:
        names: of the losses.
        gradients: the parameters that had one.
        values: [names + gradients] the losses, and each gradient's largest magnitude.
        maps: what it drew, see `Method.last_maps`; another step's as soon as a graph is replayed again.
    """

    names: tuple[str, ...]
    gradients: tuple[str, ...]
    values: Tensor
    maps: Mapping[str, Tensor]

    def losses(self) -> dict[str, Tensor]:
        return dict(zip(self.names, self.values[: len(self.names)].unbind(), strict=True))

    def magnitudes(self) -> tuple[list[str], Tensor]:
        return list(self.gradients), self.values[len(self.names) :]


Learn = Callable[[View, int], StepNumbers]


class StepGraphs:
    """Takes a method's steps: the first of each kind one kernel after the other, those that repeat it from a graph.

    Steps are taken within `on_own_stream`, and so is all else that differentiates what they train.

    Args:
        learn: all of a step's work on the device, from a view that is there. It must not wait for the device, and must
            change what lasts from step to step in place.
        learn_again: the same for a step whose loss or gradients came out of a graph not finite.
    """

    def __init__(self, learn: Learn, learn_again: Learn) -> None:
        self._learn, self._learn_again = learn, learn_again
        self._known: set[Hashable] = set()  # phases in which a step was taken without a graph
        self._graph: _Graph | None = None
        self._under_way: deque[tuple[View, int, StepNumbers, _Copy]] = deque()

    def take(self, view: View, step: int, phase: Hashable, holds: tuple[Tensor, ...]) -> StepNumbers:
        """Take one step; its numbers are final after the next `settle`.

        Args:
            view: on the device.
            phase: what the host decides of a step: steps of equal phases launch the same kernels on the same tensors.
            holds: the tensors that are trained: a graph lasts as long as they are the same ones.
        """
        kind = phase, view.image.shape, view.normal is None
        if kind not in self._known:  # kernels are compiled, and lists get their room
            self.settle()
            self._known.add(kind)
            return self._learn(view, step)
        if self._graph is None or not self._graph.serves(kind, holds):
            self.release()
            self._graph = _Graph(kind, holds, self._learn, view, step)
        numbers = self._graph.replay(view)
        self._under_way.append((view, step, numbers, _Copy(numbers.values)))
        self._settle(IN_FLIGHT)
        return numbers

    def settle(self) -> None:
        """Wait until the steps that were taken count, and take again those that did not come out finite."""
        self._settle(0)

    def release(self) -> None:
        """Give back the memory that a graph holds; the next step records another."""
        self.settle()
        self._graph = None

    def _settle(self, in_flight: int) -> None:
        while len(self._under_way) > in_flight:
            view, step, numbers, copy = self._under_way.popleft()
            if not copy.is_finite():
                # Whoever settles may only be drawing.
                with on_own_stream(numbers.values.device), torch.enable_grad():
                    again = self._learn_again(view, step).values
                    numbers.values.copy_(again)
                if bool(again.isfinite().all()):  # so it was the graph that had too little room
                    self._graph = None


class _Copy:
    """Numbers on their way from the device."""

    def __init__(self, values: Tensor) -> None:
        self._values = values.to("cpu", non_blocking=True)
        self._arrived = torch.cuda.Event()
        self._arrived.record()

    def is_finite(self) -> bool:
        self._arrived.synchronize()
        return bool(self._values.isfinite().all())


class _Graph:
    """One recording of `learn`, with its own copy of a view to read."""

    def __init__(self, kind: Hashable, holds: tuple[Tensor, ...], learn: Learn, view: View, step: int) -> None:
        self._kind, self._holds = kind, holds
        self._view = _copied(view)
        self._graph, self._numbers = recorded(lambda: learn(self._view, step), view.image.device)

    def serves(self, kind: Hashable, holds: tuple[Tensor, ...]) -> bool:
        return kind == self._kind and len(holds) == len(self._holds) and all(map(is_, holds, self._holds))

    def replay(self, view: View) -> StepNumbers:
        for mine, given in zip(_tensors(self._view), _tensors(view), strict=True):
            mine.copy_(given, non_blocking=True)
        self._graph.replay()
        return replace(self._numbers, values=self._numbers.values.clone())


def _copied(view: View) -> View:
    normal = None if view.normal is None else view.normal.clone()
    return replace(view, camera=own_camera(view.camera), image=view.image.clone(), normal=normal)


def _tensors(view: View) -> Iterator[Tensor]:
    """What a step reads of a view."""
    yield view.camera.world_to_camera
    yield view.camera.intrinsics
    yield view.image
    if view.normal is not None:
        yield view.normal
