"""TrainingLoss: what a training step minimizes (EnvGS paper, Eq. 11), by the settings on a run's clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from envgs_bench.core import Rendering, Scene, View, depth_normals
from envgs_bench.core.vectors import unit
from envgs_bench.parts import MONO, PERCEPTUAL

from ..settings import GaussianSettings
from .losses import nearness, normal_distance, normal_loss, photometric_loss
from .schedule import Schedule


@dataclass(frozen=True)
class TrainingLoss:
    """L = L_rgb + L_norm + L_mono + L_perc, each with its weight and from a step of its own on."""

    settings: GaussianSettings
    schedule: Schedule
    normal_weight: float = 1.0  # × L_mono: what the views' normals are worth

    def began(self, step: int) -> tuple[bool, bool, bool]:
        """Whether L_norm, L_mono and L_perc may count as of a step."""
        s, at = self.settings, self.schedule.at
        return step > at(s.normal_from), step > at(s.mono_from), step > at(s.perceptual_from)

    def terms(
        self,
        rendering: Rendering,
        target: Tensor,  # [H, W, 3] in [0, 1]
        view: View,
        step: int,
        trusted: Callable[[Rendering], Tensor | None],
        perceptual: Callable[[Tensor, Tensor], Tensor] | None,
    ) -> dict[str, Tensor]:
        """The weighted terms by name, scalars.

        Args:
            view: whose camera and normals are on the device of `target`.
            trusted: how much the view's own normals count at each pixel, [H, W] or None; asked where they do.
            perceptual: what L_perc is of an image and its target; None without it.
        """
        s = self.settings
        normal, mono, perceives = self.began(step)
        terms = {"rgb": photometric_loss(rendering.color, target, backend=s.backend)}
        weight = self._pixel_weights(rendering)
        if normal and s.normal_weight > 0:
            terms["normal"] = s.normal_weight * self._depth_error(rendering, view, weight)
        if mono and s.mono_weight > 0 and view.normal is not None:
            confidence = trusted(rendering)
            if weight is not None:
                confidence = weight if confidence is None else confidence * weight
            mono_weight = s.mono_weight * self.normal_weight * self.schedule.rate_scale
            terms[MONO] = mono_weight * self._mono_error(rendering, view.normal, confidence)
        if perceives and perceptual:
            terms[PERCEPTUAL] = s.perceptual_weight * perceptual(rendering.color, target)
        return terms

    def _pixel_weights(self, rendering: Rendering) -> Tensor | None:
        """What both normal losses count by at each pixel, [H, W]; None: alike everywhere."""
        match self.settings.normal_weighting:
            case "depth":
                return nearness(rendering.depth)
            case "alpha":
                return rendering.alpha.detach()
        return None

    def _depth_error(self, rendering: Rendering, view: View, weight: Tensor | None) -> Tensor:
        """Between the rendered normals and those of the depth map (Eq. 7)."""
        reference = depth_normals(rendering.depth, view.camera, backend=self.settings.backend)
        if self.settings.normal_reference == "alpha":
            reference = reference * rendering.alpha.detach()[..., None]
        normal = unit(rendering.normal) if self.settings.normal_rendered == "unit" else rendering.normal
        return normal_loss(normal, reference, weight)

    def _mono_error(self, rendering: Rendering, reference: Tensor, weight: Tensor | None) -> Tensor:
        """Between the rendered normals and the view's own [H, W, 3] (Eq. 9)."""
        normal = unit(rendering.normal) if self.settings.mono_rendered == "unit" else rendering.normal
        error = normal_loss(normal, reference, weight)
        if self.settings.mono_loss == "l1_cos":
            error = error + normal_distance(normal, reference, weight)
        return error


def lacking_normals(scene: Scene) -> str:
    """What L_mono lacks among the training views, in words; "" where all of them have normals."""
    count, those = len(scene.train), sum(view.normal is not None for view in scene.train)
    if those == count:
        return ""
    if not those:
        return "the data set has no normals for its training views"
    return f"only {those} of {count} training views have normals, and it counts at those alone"
