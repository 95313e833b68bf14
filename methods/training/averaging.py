"""ParameterAverage: what is trained, averaged over the last steps of a run (Polyak and Juditsky 1992).

Each step follows one view, at rates that do not fall to nothing, so parameters keep moving around what all views ask
for. Their mean over some steps is nearer to that than wherever the last step left them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


class ParameterAverage:
    """The mean of parameters over steps in which none changes its shape; another shape begins another mean."""

    def __init__(self) -> None:
        self._means: dict[str, Tensor] = {}
        self._steps = 0

    @torch.no_grad()
    def add(self, parameters: Mapping[str, Tensor]) -> None:
        """Take in the values after another step, by name."""
        if _shapes(self._means) != _shapes(parameters):
            self._means = {name: values.detach().clone() for name, values in parameters.items()}
            self._steps = 1
            return
        self._steps += 1
        torch._foreach_lerp_(list(self._means.values()), list(parameters.values()), 1 / self._steps)

    @torch.no_grad()
    def move(self, parameters: Mapping[str, Tensor]) -> None:
        """Move the parameters, those that were added last, to their mean."""
        torch._foreach_copy_(list(parameters.values()), list(self._means.values()))

    def state(self) -> dict[str, Any]:
        return {"means": self._means, "steps": self._steps}

    def restore(self, state: Mapping[str, Any], device: torch.device) -> None:
        """Become what `state` returned."""
        self._means = {name: mean.to(device) for name, mean in state["means"].items()}
        self._steps = state["steps"]


def _shapes(tensors: Mapping[str, Tensor]) -> dict[str, torch.Size]:
    return {name: values.shape for name, values in tensors.items()}
