"""Methods that break the contract of `Method`, each in one way: which `check_method` must name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from envgs_bench.core import Camera, Rendering, Scene, View
from envgs_bench.methods.method import Budget, Needs

from .methods import MeanColor


@dataclass
class ChangeableSettings:
    rate: float = 0.5
    crash_at: int = 0


class CanBeChanged(MeanColor):
    Settings: ClassVar[type] = ChangeableSettings


class LosesASet(MeanColor):
    def primitives(self) -> dict[str, int]:
        return {"base": 1}


class NamesAnotherSet(MeanColor):
    def primitives(self) -> dict[str, int]:
        return {"base": 1, "environment": 0}


class WeighsOtherSets(MeanColor):
    def model_bytes(self) -> dict[str, int]:
        return {"base": 12}


class WeighsNothing(MeanColor):
    def model_bytes(self) -> dict[str, int]:
        return {"base": 0, "env": 0}


class ReturnsWholeLosses(MeanColor):
    def training_step(self, view: View, step: int) -> dict[str, torch.Tensor]:
        return {"loss": torch.zeros(3)}


class AnnouncesSkips(MeanColor):
    def training_step(self, view: View, step: int) -> dict[str, float]:
        self.skipped_steps += 1
        return super().training_step(view, step)


class AppliesNaN(MeanColor):
    def training_step(self, view: View, step: int) -> dict[str, float]:
        losses = super().training_step(view, step)
        if not math.isfinite(losses["loss"]):
            self.color = torch.zeros(3)
        return losses


class CountsNoSkips(MeanColor):
    def training_step(self, view: View, step: int) -> dict[str, float]:
        losses = super().training_step(view, step)
        self.skipped_steps = 0
        return losses


class IgnoresItsPerceptualLoss(MeanColor):
    needs = Needs(perceptual="features")


class NeedsPreparing(MeanColor):
    """Draws what it learned only if `prepare` was called twice."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.prepared = 0

    def prepare(self) -> None:
        self.prepared += 1

    def render(self, camera: Camera) -> Rendering:
        rendering = super().render(camera)
        rendering.color = rendering.color * min(self.prepared, 2)
        return rendering


class _RendersOtherwise(MeanColor):
    def render(self, camera: Camera) -> Rendering:
        rendering = super().render(camera)
        self.change(rendering)
        return rendering

    def change(self, rendering: Rendering) -> None:
        raise NotImplementedError


class RendersGradients(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.color = rendering.color.clone().requires_grad_()


class RendersHalf(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.depth = rendering.depth[::2, ::2]


class RendersDoubles(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.alpha = rendering.alpha.double()


class TakesTheHarnesssLayer(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.layers["normal"] = rendering.normal


class DrawsHalfALayer(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.layers["beta"] = rendering.alpha[::2]


class DrawsLayersOfNaN(_RendersOtherwise):
    def change(self, rendering: Rendering) -> None:
        rendering.layers["beta"] = rendering.alpha * math.nan


class LoadsAnything(MeanColor):
    def load(self, folder: Path) -> None:
        if (folder / "color.pt").exists():
            super().load(folder)


class ForgetsItsTraining(MeanColor):
    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self.initialize(scene, steps)


class ExceedsItsBudget(MeanColor):
    def limit(self, budget: Budget) -> None:
        self.most = budget.primitives

    def primitives(self) -> dict[str, int]:
        return {"base": 101, "env": 0}


class ForgetsItsCount(MeanColor):
    """Counts a primitive more once it is loaded."""

    surplus = 0

    def load(self, folder: Path) -> None:
        super().load(folder)
        self.surplus = 1

    def primitives(self) -> dict[str, int]:
        return {"base": 1 + self.surplus, "env": 0}
