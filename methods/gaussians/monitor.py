"""GaussianMonitor: what the harness may look at while a method trains sets of Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from torch import Tensor

from ..method import Monitor
from ..training.step_runner import StepRunner
from .model import GaussianModel


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
        return self._model.at_size_limit()

    def non_finite_gradients(self) -> list[str]:
        return self._runner.take_non_finite()

    def prunes(self, step: int) -> bool:
        return any(event.name == "prune" for event in self._runner.due(step))

    def reflected(self, origins: Tensor, directions: Tensor) -> Tensor | None:
        return None if self._reflected is None else self._reflected(origins, directions)
