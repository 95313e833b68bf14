"""StepRunner: how training steps are taken, on a GPU from CUDA graphs: gradients, skipped steps, averaging."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Statistics, View
from envgs_bench.parts import ALPHA, BETA

from .averaging import ParameterAverage
from .exposure import AffineExposure
from .losses import StepNumbers, TrainingLoss, training_psnr
from .resident_views import ResidentViews
from .schedule import Every, Schedule
from .step_graphs import Learning, StepGraphs

REMEMBERED_STEPS = 32  # whose gradients' magnitudes are kept, to say which were not finite


@dataclass(frozen=True)
class Work:
    """What a method does in a step, and the runner calls.

    Attributes:
        draw: the picture of a camera at a step, with gradients, and each set's statistics.
        losses: the terms by name of the picture, its target [H, W, 3], the view and the step.
        phase: what the host decides of a step.
        optimizers: all of them: they step together, or none does.
        parameters: all that they move, by name.
        record: what later changes of the sets will ask: of the picture, the statistics, the camera, the step, and
            whether the step counts, a truth on the device.
        drift: what moves after Adam, of whether the step counts, a truth on the device.
    """

    draw: Callable[[Camera, int], tuple[Rendering, dict[str, Statistics]]]
    losses: Callable[[Rendering, Tensor, View, int], dict[str, Tensor]]
    phase: Callable[[int], Hashable]
    optimizers: Callable[[], Sequence[torch.optim.Optimizer]]
    parameters: Callable[[], Iterable[tuple[str, Tensor]]]
    record: Callable[[Rendering, Mapping[str, Statistics], Camera, int, Tensor], None]
    drift: Callable[[Tensor], None]


class StepRunner:
    """Takes the steps of one training.

    Attributes:
        loss: the terms that steps minimize.
        skipped: training steps that were not applied because a loss or gradient was not finite.
        maps: what the last step drew, see `Monitor.last_maps`.
        views: the training views on the device.
        events: what befalls the model between steps, in this order.
        exposure: each training view's own, which steps show their pictures by; None: views are alike.
        graphs: the steps' CUDA graphs.
        uses_graphs: whether steps are taken from them.
    """

    def __init__(self, work: Work, loss: TrainingLoss, device: torch.device, owner: str, uses_graphs: bool) -> None:
        self.loss = loss
        self.skipped: int | Tensor = 0
        self.maps: Mapping[str, Tensor] = {}
        self.uses_graphs = uses_graphs
        self.exposure: AffineExposure | None = None
        self._work, self._device, self._owner = work, device, owner
        self._still = torch.zeros((), device=device)  # 0, or infinite while a replay must move nothing
        self._gradients = RememberedGradients()
        self._schedule, self._average_from = Schedule(1), 0
        self.start(Schedule(1), 0, ResidentViews(device, room=0), ())

    def start(self, schedule: Schedule, average_from: int, views: ResidentViews, events: Sequence[Every]) -> None:
        """Begin a training.

        Args:
            average_from: step of a run of 30,000 after which parameters are averaged; 0: never.
        """
        self._schedule, self._average_from = schedule, average_from
        self._average = ParameterAverage()
        self.views, self.events = views, events
        self.graphs = StepGraphs(Learning(self.learn, self._learn_again, self._without_moving), self._owner)

    def take(self, view: View, step: int) -> dict[str, Tensor]:
        """Take one step on a view that is on the device, and do what events are due after it; the losses."""
        if self.uses_graphs and self.exposure is None:  # a graph would hold one view's map
            holds = tuple(parameter for _, parameter in self._work.parameters())
            numbers = self.graphs.take(view, step, self._work.phase(step), holds)
        else:
            numbers = self.learn(view, step)
        self._gradients.add(*numbers.magnitudes())
        self.maps = numbers.maps
        due = self.due(step)
        if due:
            self.settle()
        with torch.no_grad():
            for event in due:
                event.action(step)
        self._average_parameters(step, anew=bool(due))
        return numbers.losses()

    def hear_of_noise(self, beside: float) -> None:
        """From here on the loss knows which share of the views' squared error is not their noise."""
        self.loss = replace(self.loss, beside_noise=beside)

    def due(self, step: int) -> list[Every]:
        """What befalls the model after a step, in this order."""
        return [event for event in self.events if event.due(step, self._schedule.steps)]

    def learn(self, view: View, step: int) -> StepNumbers:
        """All of a step that happens on the device. It never waits there, not even to learn whether the step counts."""
        work, camera, target = self._work, view.camera, view.rgb(self._device)
        rendering, statistics = work.draw(camera, step)
        color, held = rendering.color, {}
        if self.exposure is not None:
            color, held = self.exposure.applied(view.name, color), {"exposure": self.exposure.loss(view.name)}
        terms = work.losses(replace(rendering, color=color), target, view, step) | held
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()

        gradients = [(name, p.grad) for name, p in work.parameters() if p.grad is not None and p.grad.numel()]
        magnitudes = largest_magnitudes([loss.detach(), *(gradient for _, gradient in gradients), self._still])
        counts = all_finite(magnitudes)
        work.record(rendering, statistics, camera, step, counts)  # before Adam moves what was drawn
        optimizers = work.optimizers()
        self.skipped += step_together(optimizers, counts)
        work.drift(counts)
        for optimizer in optimizers:
            optimizer.zero_grad(set_to_none=True)

        shown = {"loss": loss, "psnr": training_psnr(color, target), **terms}
        losses = torch.stack([value.detach() for value in shown.values()])
        values = torch.cat([losses, magnitudes[1:-1]])
        return StepNumbers(tuple(shown), tuple(name for name, _ in gradients), values, _maps_of(rendering))

    def settle(self) -> None:
        """Finish what the last steps left under way."""
        self.graphs.settle()

    def take_non_finite(self) -> list[str]:
        """Parameters whose gradients were not finite in any step since the last call, each once."""
        self.settle()
        return self._gradients.take_non_finite()

    def training_state(self) -> dict[str, Any]:
        self.settle()
        return {
            "skipped": self.skipped.clone() if isinstance(self.skipped, Tensor) else self.skipped,
            "gradients": self._gradients.training_state(),
            "average": self._average.state(),
        }

    def restore_training(self, state: Mapping[str, Any]) -> None:
        """Become what `training_state` returned, tensors on the CPU."""
        skipped = state["skipped"]
        self.skipped = skipped.to(self._device) if isinstance(skipped, Tensor) else skipped
        self._gradients.restore_training(state["gradients"])
        self._average.restore(state["average"], self._device)

    def _learn_again(self, view: View, step: int) -> StepNumbers:
        self.skipped -= 1  # the first try
        return self.learn(view, step)

    def _without_moving(self, replay: Callable[[], StepNumbers]) -> StepNumbers:
        self._still.fill_(math.inf)
        numbers = replay()
        self._still.zero_()
        self.skipped -= 1  # which no step was
        return numbers

    def _average_parameters(self, step: int, anew: bool) -> None:
        """Late in a run, take the step into the average, which the last step ends with.

        Args:
            anew: whether something befell the sets: what they were before is another thing than what they become.
        """
        start, last = self._average_from, step == self._schedule.steps
        if start == 0 or step <= self._schedule.at(start):
            return
        if anew:
            self._average = ParameterAverage()
        if last:
            self.settle()
        parameters = dict(self._work.parameters())
        self._average.add(parameters)
        if last:
            self._average.move(parameters)
            self._average = ParameterAverage()  # whose memory whatever follows can use


class RememberedGradients:
    """The largest magnitudes of the gradients of the last steps, left on the device until somebody asks."""

    def __init__(self) -> None:
        self._steps: deque[tuple[list[str], Tensor]] = deque(maxlen=REMEMBERED_STEPS)

    def add(self, names: list[str], magnitudes: Tensor) -> None:
        """Those of one step: of the parameters so named, [names]."""
        self._steps.append((names, magnitudes))

    def take_non_finite(self) -> list[str]:
        """Whose were not finite in any step since the last call, each once; waits for the device."""
        found = [
            name
            for names, magnitudes in self._steps
            for name, magnitude in zip(names, magnitudes.tolist(), strict=True)
            if not math.isfinite(magnitude)
        ]
        self._steps.clear()
        return list(dict.fromkeys(found))

    def training_state(self) -> list[Any]:
        return [[names, magnitudes] for names, magnitudes in self._steps]

    def restore_training(self, state: list[Any]) -> None:
        """Become what `training_state` returned."""
        self._steps.clear()
        self._steps.extend((names, magnitudes) for names, magnitudes in state)


def largest_magnitudes(tensors: list[Tensor]) -> Tensor:
    """Each tensor's largest magnitude, [N]; NaN where it holds one. None of the tensors may be empty.

    On a GPU one kernel, which takes a CPU sixteen times as long.
    """
    if tensors[0].is_cuda:
        return torch.stack(torch._foreach_norm(tensors, math.inf))
    return torch.stack([tensor.abs().amax() for tensor in tensors])


def all_finite(magnitudes: Tensor) -> Tensor:
    """Whether a step whose loss and gradients are so large counts, a scalar on the device."""
    return magnitudes.amax() < math.inf  # NaN is not


def step_together(optimizers: Sequence[torch.optim.Optimizer], counts: Tensor) -> Tensor:
    """Step all of them where `counts`, a truth on the device, is true, and none where it is not; 1 where none did."""
    skipped = (~counts).float()
    for optimizer in optimizers:
        optimizer.found_inf = skipped  # type: ignore[attr-defined]  # torch's way to skip a fused step
        optimizer.step()
    return skipped


def parameters_of(optimizers: Iterable[torch.optim.Optimizer]) -> Iterator[tuple[str, Tensor]]:
    """What these optimizers move, by their groups' names."""
    for optimizer in optimizers:
        for group in optimizer.param_groups:
            for parameter in group["params"]:
                yield group.get("name", "parameters"), parameter


def _maps_of(rendering: Rendering) -> dict[str, Tensor]:
    """What `last_maps` shows of a step: alpha, and the first extra channel where there is one."""
    maps = {ALPHA: rendering.alpha.detach()}
    if rendering.extras.shape[-1]:
        maps[BETA] = rendering.extras.detach()[..., 0]
    return maps
