"""Gradients of a training step: how large they are, and whose were not finite in the last ones."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import torch
from torch import Tensor

REMEMBERED_STEPS = 32  # whose gradients' magnitudes are kept, to say which were not finite


def largest_magnitudes(tensors: list[Tensor]) -> Tensor:
    """Each tensor's largest magnitude, [N]; NaN where it holds one. None of the tensors may be empty.

    On a GPU one kernel, which takes a CPU sixteen times as long.
    """
    if tensors[0].is_cuda:
        return torch.stack(torch._foreach_norm(tensors, math.inf))
    return torch.stack([tensor.abs().amax() for tensor in tensors])


def all_finite(magnitudes: Tensor) -> Tensor:
    """Whether a step whose loss and gradients are so large counts, a scalar on the device."""
    return magnitudes.isfinite().all()


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
