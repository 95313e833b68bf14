"""TrainedSet: one set of Gaussians in training, with the statistics of its steps."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from .densification import DensificationRecord, DensificationRule, Oversized, densify
from .parameters import GaussianParameters
from .relocation import relocate

RESET_OPACITY = 0.01
PROPAGATED_OPACITY = 0.9


class TrainedSet:
    """Attributes:
    held_until: step up to which all opacities stay as they are; None where they never did.
    """

    def __init__(self, parameters: GaussianParameters) -> None:
        self.parameters = parameters
        self.record = DensificationRecord(len(parameters), parameters.tensors["means"].device)
        self.held_until: int | None = None

    def training_state(self) -> dict[str, Any]:
        return {
            "parameters": self.parameters.training_state(),
            "record": self.record.training_state(),
            "held_until": self.held_until,
        }

    def restore_training(self, state: dict[str, Any]) -> None:
        """Become what `training_state` returned."""
        self.parameters.restore_training(state["parameters"])
        self.record.restore_training(state["record"])
        self.held_until = state["held_until"]

    def densify(
        self, rule: DensificationRule, radius: float, generator: torch.Generator, oversized: Oversized = "split"
    ) -> None:
        """Grow and shrink by the rule and what the last steps recorded, with `densify`'s arguments."""
        self.record = densify(self.parameters, self.record, rule, radius, generator, oversized)

    def relocate(self, most: int, generator: torch.Generator, *, guided: bool) -> None:
        """Grow to at most so many primitives by MCMC, which may be guided by what the last steps recorded."""
        self.record = relocate(self.parameters, most, generator, self.record if guided else None)

    def keep(self, rows: Tensor) -> None:
        """Keep only the primitives that a mask [N] names, with what was recorded of them."""
        draft = self.parameters.draft()
        draft.keep(rows)
        self.parameters.become(draft)
        self.record.keep(rows)

    def reset_opacity(self) -> None:
        """Opacities down to at most 0.01 (3DGS), so that what no view needs can be pruned, and trained again."""
        logits = self.parameters.tensors["opacity_logits"].detach()
        self.parameters.replace("opacity_logits", logits.clamp_max(_logit(RESET_OPACITY)))
        if self.held_until is not None:
            self.held_until = 0  # or opacities would stay where the reset left them, and all be pruned

    def raise_opacity(self, rows: Tensor, held_until: int) -> None:
        """Opacities of a mask [N] up to at least 0.9 (3DGS-DR's normal propagation), and held up to that step."""
        logits = self.parameters.tensors["opacity_logits"].detach()
        raised = logits.clamp_min(_logit(PROPAGATED_OPACITY))
        self.parameters.replace("opacity_logits", torch.where(rows, raised, logits))
        self.held_until = held_until


def _logit(probability: float) -> float:
    return math.log(probability / (1 - probability))
