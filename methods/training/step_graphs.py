"""StepGraphs: a training step's work on a GPU as a CUDA graph, recorded once and replayed while only values change.

A step of a small scene is hundreds of kernels of a few microseconds, and Python launches them more slowly than they
run. A graph is launched at once. It holds addresses and sizes, so it lasts until a set grows or the method does
something else in a step; a densification is followed by another recording, which takes as long as a step without one.

Nobody can look into a graph that runs: an image that had too little room for its lists is NaN, which no optimizer
applies, and the step is taken again as it would have been without a graph.

What a graph holds of a step's number is what it was when the graph was recorded. So graphs are proved: at the first
replay of a phase and now and then later, a replay that moves nothing is compared with the same step launched.
"""

from __future__ import annotations

import warnings
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from operator import is_

import torch
from torch import Tensor

from envgs_bench.core import View

from .cuda_graphs import on_own_stream, recorded
from .losses import StepNumbers

IN_FLIGHT = 1  # steps that the device may be behind when another is launched: it then never waits for the host
LOSS_TOLERANCE = 1e-3  # relative; a sum's order is any order on a GPU, and a loss of a launched step varies by 1e-6
GRADIENT_TOLERANCE = 0.1  # relative, of each gradient's largest magnitude
TINY = 1e-7


class GraphWarning(UserWarning):
    """A method's steps depend on what a CUDA graph cannot know; they are launched from then on."""


@dataclass(frozen=True)
class Learning:
    """A step's work, as graphs need it.

    Attributes:
        launch: all of it on the device, from a view that is there. It must not wait for the device, and must change
            what lasts from step to step in place.
        again: the same for a step whose loss or gradients came out of a graph not finite.
        without_moving: do what is given, a replay, with nothing moved, recorded or counted by it.
    """

    launch: Callable[[View, int], StepNumbers]
    again: Callable[[View, int], StepNumbers]
    without_moving: Callable[[Callable[[], StepNumbers]], StepNumbers]


class StepGraphs:
    """Takes a method's steps: the first of each kind launched, those that repeat it replayed from a graph.

    Steps are taken within `on_own_stream`, and so is all else that differentiates what they train.

    Args:
        learning: what a step is.
        owner: whose steps these are, as a warning names it.

    Attributes:
        proved_wrong: why steps are launched from now on; "" while graphs are used.
    """

    def __init__(self, learning: Learning, owner: str) -> None:
        self.proved_wrong = ""
        self._learning, self._owner = learning, owner
        self._launched: dict[Hashable, int] = {}  # phase -> the step in which it was first launched
        self._replays: Counter[Hashable] = Counter()  # of each phase, those that are compared among them
        self._graph: _Graph | None = None
        self._under_way: deque[tuple[View, int, StepNumbers, _Copy]] = deque()

    def take(self, view: View, step: int, phase: Hashable, holds: tuple[Tensor, ...]) -> StepNumbers:
        """Take one step; its numbers are final after the next `settle`.

        Args:
            view: on the device.
            phase: what the host decides of a step: steps of equal phases launch the same kernels on the same tensors.
            holds: the tensors that are trained: a graph lasts as long as they are the same ones.
        """
        if self.proved_wrong:
            return self._learning.launch(view, step)
        kind = phase, view.image.shape, view.normal is None
        if kind not in self._launched:  # kernels are compiled, and lists get their room
            self.settle()
            self._launched[kind] = step
            return self._learning.launch(view, step)
        if self._graph is None or not self._graph.serves(kind, holds):
            self.release()
            # As of an earlier step of the phase: what depends on the number otherwise shows at the first replay.
            self._graph = _Graph(kind, holds, self._learning.launch, view, self._launched[kind])
        self._replays[kind] += 1
        if is_compared(self._replays[kind]):
            return self._compared(self._graph, view, step)
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

    def _compared(self, graph: _Graph, view: View, step: int) -> StepNumbers:
        """The step launched, and beside it the same one replayed without consequence."""
        self.settle()
        replayed = self._learning.without_moving(lambda: graph.replay(view))
        launched = self._learning.launch(view, step)
        if not replayed.values.isfinite().all():
            self._graph = None  # too little room, or a step that does not count: nothing is shown
        elif wrong := difference(replayed, launched):
            self._graph = None
            self.proved_wrong = (
                f"{self._owner} is not what its CUDA graph replays: {wrong} at step {step}. Its steps are launched from"
                " now on. What `draw` and `losses` do may depend on the step through `phase` alone"
            )
            warnings.warn(self.proved_wrong, GraphWarning, stacklevel=2)
        return launched

    def _settle(self, in_flight: int) -> None:
        while len(self._under_way) > in_flight:
            view, step, numbers, copy = self._under_way.popleft()
            if not copy.is_finite():
                # Whoever settles may only be drawing.
                with on_own_stream(numbers.values.device), torch.enable_grad():
                    again = self._learning.again(view, step).values
                    numbers.values.copy_(again)
                if bool(again.isfinite().all()):  # so it was the graph that had too little room
                    self._graph = None


def is_compared(replay: int) -> bool:
    """Whether a phase's replay of this number, from 1, is compared: 1, 4, 16, … of them, a dozen in the longest run."""
    return replay.bit_count() == 1 and replay.bit_length() % 2 == 1


def difference(replayed: StepNumbers, launched: StepNumbers) -> str:
    """In what two takes of one step differ, in words; "" where they are the same to rounding."""
    if (replayed.names, replayed.gradients) != (launched.names, launched.gradients):
        return "it has other losses or gradients"
    names = [f"loss {name}" for name in launched.names] + [f"gradient of {name}" for name in launched.gradients]
    tolerances = [LOSS_TOLERANCE] * len(launched.names) + [GRADIENT_TOLERANCE] * len(launched.gradients)
    pairs = zip(names, replayed.values.tolist(), launched.values.tolist(), tolerances, strict=True)
    for name, one, other, tolerance in pairs:
        if not abs(one - other) <= tolerance * max(abs(one), abs(other)) + TINY:
            return f"{name} is {one:.6g} replayed and {other:.6g} launched"
    return ""


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
    """One recording of a step, with its own copy of a view to read."""

    def __init__(self, kind: Hashable, holds: tuple[Tensor, ...], launch: Launch, view: View, step: int) -> None:
        self._kind, self._holds = kind, holds
        self._view = _copied(view)
        self._graph, self._numbers = recorded(lambda: launch(self._view, step), view.image.device)

    def serves(self, kind: Hashable, holds: tuple[Tensor, ...]) -> bool:
        return kind == self._kind and len(holds) == len(self._holds) and all(map(is_, holds, self._holds))

    def replay(self, view: View) -> StepNumbers:
        for mine, given in zip(_tensors(self._view), _tensors(view), strict=True):
            mine.copy_(given, non_blocking=True)
        self._graph.replay()
        return replace(self._numbers, values=self._numbers.values.clone())


Launch = Callable[[View, int], StepNumbers]


def _copied(view: View) -> View:
    normal = None if view.normal is None else view.normal.clone()
    return replace(view, camera=view.camera.clone(), image=view.image.clone(), normal=normal)


def _tensors(view: View) -> Iterator[Tensor]:
    """What a step reads of a view."""
    yield view.camera.world_to_camera
    yield view.camera.intrinsics
    yield view.image
    if view.normal is not None:
        yield view.normal
