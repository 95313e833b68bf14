"""GaussianMonitor: what the harness may look at while a method trains sets of Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from torch import Tensor

from ..method import Monitor
from ..training.step_runner import StepRunner
from .model import GaussianModel

FULL = 0.95  # share of its size limit from which a set is held back by it: some are pruned between two densifications


class GaussianMonitor(Monitor):
    """Of a model, of the runner of its steps, and of what reflected rays see."""

    def __init__(
        self,
        model: GaussianModel,
        runner: StepRunner,
        reflected: Callable[[Tensor, Tensor], Tensor | None] | None,
    ) -> None:
        self._model, self._runner, self._reflected = model, runner, reflected

    def last_maps(self) -> Mapping[str, Tensor]:
        return self._runner.maps

    def degenerate(self) -> Mapping[str, Tensor]:
        sets = self._model.sets.items()
        return {name: trained.parameters.degenerate() for name, trained in sets if len(trained.parameters)}

    def at_size_limit(self) -> Mapping[str, int]:
        limits = {name: self._model.policies[name].size_limit for name in self._model.sets}
        return {name: most for name, most in limits.items() if 0 < FULL * most <= self._model.size(name)}

    def non_finite_gradients(self) -> list[str]:
        return self._runner.take_non_finite()

    def prunes(self, step: int) -> bool:
        return any(event.name == "prune" for event in self._runner.due(step))

    def reflected(self, origins: Tensor, directions: Tensor) -> Tensor | None:
        return None if self._reflected is None else self._reflected(origins, directions)
