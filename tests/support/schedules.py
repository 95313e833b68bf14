"""A training's steps taken apart: when its events happen, and what they and the beginnings of steps do."""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import Tensor

from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.training.step_runner import parameters_of


def begin(method: GaussianMethod, step: int) -> None:
    """All that a training step does before it draws."""
    for part in method.parts.values():
        part.begin_step(step)
    method.model.set_learning_rates(step)


def due(method: GaussianMethod, step: int) -> set[str]:
    """The names of the events after a step."""
    return {event.name for event in method.runner.due(step)}


def befall(method: GaussianMethod, step: int, names: Collection[str]) -> None:
    """Let the events of these names happen after a step."""
    with torch.no_grad():
        for event in method.runner.events:
            if event.name in names:
                event.action(step)


def optimizers_of(method: GaussianMethod) -> list[torch.optim.Optimizer]:
    return [*method.model.optimizers(), *(each for part in method.parts.values() for each in part.optimizers())]


def trained_by(method: GaussianMethod) -> dict[str, Tensor]:
    """All that the method's optimizers move, by name."""
    of_parts = (optimizer for part in method.parts.values() for optimizer in part.optimizers())
    return dict([*method.model.named_parameters(), *parameters_of(of_parts)])


def steps_of_events(method: GaussianMethod, run: int) -> dict[str, list[int]]:
    """The steps of each event of a run of `run` steps, of those at and next to each hundredth."""
    found: dict[str, list[int]] = {}
    for step in (hundred + beside for hundred in range(100, run, 100) for beside in (-1, 0, 1)):
        for event in due(method, step):
            found.setdefault(event, []).append(step)
    return found
