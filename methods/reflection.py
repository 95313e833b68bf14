"""ReflectiveMethod: what EnvGS and the environment map share, all but where the reflected color comes from.

A rasterized base set gives each pixel's surface point, normal, base color and blending weight β; the reflected ray's
color is blended over the base (EnvGS paper, Sec. 4.1).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, Statistics, reflect
from envgs_bench.parts import BASE, BETA, REFLECTION

from .gaussian_method import GaussianMethod
from .gaussians.parameters import LearningRates, inverse_sigmoid
from .lighting.supersampling import averaged, finer, repeated
from .settings import GaussianSettings, check_words

SABOTAGE_BELOW = 0.05  # β up to which a base color is disturbed
SABOTAGE_RANGE = 0.4
PROPAGATE_ABOVE = 0.02  # β from which a primitive is enlarged
PROPAGATE_SCALE = 1.5
PROPAGATE_HOLD = 200  # steps of a run of 30,000 after a propagation in which opacities stay as they are
HOLD_FLOOR = 10  # steps
SETTLING_DENSIFICATIONS = 10  # densifications of the base that fit between `bootstrap` and `disturb_until`


@dataclass(frozen=True)
class ReflectionSettings(GaussianSettings):
    """Settings of a base set with reflections. Steps are those of a run of 30,000."""

    rotation_lr_final: float = 1e-4  # learning rate of the quaternions at the end: low, as a mirror doubles each degree

    scale_lr: float = 1e-2

    normal_from: int = 7_000
    mono_weight: float = 0.05
    mono_loss: str = "l1_cos"
    mono_floor: float = 0.1  # share of mono_weight where nothing reflects; all of it counts from β = initial_beta on
    perceptual_weight: float = 0.0

    densify_until: int = 18_000
    densify_every: int = 300
    min_coverage: float = 1.5
    pixels_per_primitive: float = 7.0
    settling_interval: int = 5  # × densify_every between bootstrap and disturb_until; less in a short run

    bootstrap: int = 3_000  # steps with the base set alone
    joint: bool = True  # reflected rays pass gradients on to the base set's normals and positions
    initial_beta: float = 0.1  # β that base primitives start with: 1e-3 where little reflects, to 0.1 where much does
    beta_lr: float = 1e-2  # learning rate of β's logits
    beta_threshold: float = 1 / 255  # an image traces no ray whose β is below; in training every surface reflects
    beta_filter: float = 0.0  # share of an image's pixels, those of the smallest β, that are not traced either
    supersampling: int = 1  # reflected rays along each side of a pixel: 2 are four a pixel
    ray_offset: float = 1e-3  # a reflected ray starts this far above the surface, × scene radius
    reflect_alpha: float = 0.0  # pixels whose alpha is not above do not reflect: in images, and late in training
    reflect_alpha_from: int = 0  # step after which that holds in training too

    disturb_every: int = 0  # steps between color sabotages and normal propagations; 0: never
    disturb_until: int = 18_000  # step up to which disturbances go on, and densifications are settling_interval apart
    sabotage: bool = True  # disturb the base color of primitives that do not reflect
    propagate: bool = True  # enlarge primitives that reflect, so that their normals spread
    beta_reset_from: int = 0  # step from which opacity resets also reset β; 0: never
    beta_reset: str = "lower"  # that lowers β to at most its start, or raises it to at least that: raise


class ReflectiveMethod(GaussianMethod):
    """A base set of surfels with β, and reflected rays."""

    Settings: ClassVar[type] = ReflectionSettings
    settings: ReflectionSettings
    axes = 2

    def __init__(self, settings: ReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        check_words(settings, {"beta_reset": ("lower", "raise")})
        if not 0 <= settings.beta_filter < 1:
            raise ValueError(f"beta_filter is {settings.beta_filter:g}, expected a share of at least 0 and below 1")
        if settings.settling_interval < 1:
            raise ValueError(f"settling_interval is {settings.settling_interval}, expected at least 1 × densify_every")
        if not 0 < settings.initial_beta < 1:
            raise ValueError(f"initial_beta is {settings.initial_beta:g}, expected a weight between 0 and 1")
        if settings.supersampling < 1:
            raise ValueError(f"supersampling is {settings.supersampling}, expected at least 1 ray along a pixel's side")
        if not 0 <= settings.mono_floor <= 1:
            raise ValueError(f"mono_floor is {settings.mono_floor:g}, expected a share from 0 to 1")
        self.reflects = False  # True once the bootstrapping is over
        self._hold_until = 0

    @abstractmethod
    def start_reflection(self) -> None:
        """Make what the reflected color comes from: called once, before the first step after the bootstrapping."""

    @abstractmethod
    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        """The color that reflected rays see, and of a training step each traced set's statistics.

        `draw` calls it after bootstrapping.

        Args:
            origins, directions: [H, W, 3] of `reflect`, world frame; the direction is 0 where nothing reflects.
            step: the training's; None for an image.

        Returns:
            Color [H, W, 3], sRGB; differentiable in the rays where they carry gradients.
        """

    @torch.no_grad()
    def reflected(self, origins: Tensor, directions: Tensor) -> Tensor | None:
        return self.reflected_color(origins[None], directions[None], None)[0][0] if self.reflects else None

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.reflects, self._hold_until = False, 0

    def before_step(self, step: int) -> None:
        super().before_step(step)
        if not self.reflects and step > self.schedule.at(self.settings.bootstrap):
            self.start_reflection()
            self.reflects = True

    def set_learning_rates(self, step: int) -> None:
        super().set_learning_rates(step)
        opacity_rate = 0.0 if step <= self._hold_until else self.settings.opacity_lr
        self.sets[BASE].parameters.set_learning_rate("opacity_logits", opacity_rate)

    def phase(self, step: int) -> Hashable:
        reflects_less = step > self.schedule.at(self.settings.reflect_alpha_from)
        return super().phase(step), self.reflects, reflects_less

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.rasterize_base(camera, step)
        statistics = {BASE: base.statistics}
        if not self.reflects:
            return base, statistics
        points = self.settings.supersampling
        origins, directions, beta = self._reflected_rays(*finer(base, camera, points), step)
        reflection, of_rays = self.reflected_color(origins, directions, step)
        if points > 1:
            for seen in of_rays.values():
                seen.weights = seen.weights / points**2  # in pixels, as the base's
        statistics |= of_rays
        beta = beta[..., None]
        blended = averaged(torch.lerp(repeated(base.color, points), reflection, beta), points)  # Eq. 5
        layers = {BASE: base.color, REFLECTION: averaged(reflection * (beta > 0), points), BETA: base.extras}
        return replace(base, color=blended, layers=layers), statistics

    def _reflected_rays(self, base: Rendering, camera: Camera, step: int | None) -> tuple[Tensor, Tensor, Tensor]:
        """Origins, directions and β of `reflect`: in training of every surface, in an image where it is visible."""
        if not self.settings.joint:
            base = replace(base, normal=base.normal.detach(), depth=base.depth.detach())
        least = self.settings.reflect_alpha
        if least > 0 and (step is None or step > self.schedule.at(self.settings.reflect_alpha_from)):
            base = replace(base, extras=base.extras * (base.alpha > least)[..., None])
        return reflect(
            base,
            camera,
            offset=self.settings.ray_offset * self.radius,
            beta_min=0.0 if step is not None else self._min_beta(base.extras),
            backend=self.settings.backend,
        )

    def _min_beta(self, beta: Tensor) -> Tensor | float:
        """The β [H, W, 1] of an image above which its rays are traced (paper, App. B.2)."""
        threshold, share = self.settings.beta_threshold, self.settings.beta_filter
        if share == 0:
            return threshold
        rank = max(1, round(share * beta.numel()))
        # Sorted whole: on a GPU torch's kthvalue takes longer than the rays that are spared.
        return beta.flatten().sort().values[rank - 1].clamp_min(threshold)

    def mono_weights(self, rendering: Rendering) -> Tensor | None:
        """1 where β is at least its start, in proportion to β below, and `mono_floor` at least.

        On a mirror the depth map follows the reflected scene: only the view's own normals constrain the surface. On
        matte surfaces the depth map is more accurate than an estimate that is off by some degrees.
        """
        s = self.settings
        if s.mono_floor == 1:
            return None
        return (rendering.extras.detach()[..., 0] / s.initial_beta).clamp(s.mono_floor, 1)

    def events(self, step: int) -> set[str]:
        s, schedule = self.settings, self.schedule
        happens = super().events(step)
        if schedule.disturbs(
            step,
            start=s.bootstrap,
            stop=s.disturb_until,
            interval=s.disturb_every,
            reset_interval=s.opacity_reset_every,
        ):
            happens |= {name for name, wanted in (("sabotage", s.sabotage), ("propagate", s.propagate)) if wanted}
        if "reset_base_opacity" in happens and s.beta_reset_from and step >= schedule.at(s.beta_reset_from):
            happens.add("reset_beta")
        return happens

    def densification_interval(self, step: int) -> Fraction:
        usual, s = super().densification_interval(step), self.settings
        start, stop = self.schedule.at(s.bootstrap), self.schedule.at(s.disturb_until)
        if usual == 0 or not start < step <= stop:
            return usual
        longest = (stop - start) // (SETTLING_DENSIFICATIONS * usual)
        return usual * max(1, min(s.settling_interval, longest))

    def after_step(self, step: int, events: set[str]) -> None:
        super().after_step(step, events)
        if "reset_base_opacity" in events:
            self._hold_until = 0  # or opacities would stay where the reset left them, and all be pruned
        if "sabotage" in events:
            self._sabotage()
        if "propagate" in events:
            self._propagate(step)
        if "reset_beta" in events:
            self._reset_beta()

    def _sabotage(self) -> None:
        """Disturb the base color where the base does not reflect (3DGS-DR), so that a reflection may explain it."""
        parameters = self.sets[BASE].parameters
        dc = parameters.tensors["sh_dc"].detach()
        noise = (2 * torch.rand(dc.shape, generator=self.generator) - 1).to(dc) * SABOTAGE_RANGE
        disturbed = self.is_sabotaged() & self.may_reflect()
        parameters.replace("sh_dc", dc + noise * disturbed[:, None, None])

    def _propagate(self, step: int) -> None:
        """Grow primitives that reflect over their neighbors, so that good normals spread (3DGS-DR).

        They grow along their surface, which for a 3D Gaussian lies across its shortest axis. All become nearly opaque,
        and opacities are then not trained for a while.
        """
        parameters = self.sets[BASE].parameters
        log_scales = parameters.tensors["log_scales"].detach()
        allowed = self.may_reflect()
        grows = (self.spreads() & allowed)[:, None].expand_as(log_scales)
        if self.axes == 3:
            grows = grows.scatter(1, log_scales.argmin(1, keepdim=True), False)
        parameters.replace("log_scales", log_scales + math.log(PROPAGATE_SCALE) * grows)
        self.sets[BASE].raise_opacity(allowed)
        self._hold_until = step + round(self.schedule.interval(PROPAGATE_HOLD, HOLD_FLOOR))

    def _reset_beta(self) -> None:
        parameters = self.sets[BASE].parameters
        logits = parameters.tensors["beta_logits"].detach()
        start = inverse_sigmoid(torch.full_like(logits, self.settings.initial_beta))
        bounded = torch.minimum if self.settings.beta_reset == "lower" else torch.maximum
        parameters.replace("beta_logits", torch.where(self.may_reflect()[:, None], bounded(logits, start), logits))

    def is_sabotaged(self) -> Tensor:
        """Whose base color sabotage disturbs, [N] of the base set: what does not reflect."""
        return self.beta() <= SABOTAGE_BELOW

    def spreads(self) -> Tensor:
        """What normal propagation enlarges, [N] of the base set: what reflects."""
        return self.beta() >= PROPAGATE_ABOVE

    def may_reflect(self) -> Tensor:
        """What disturbances and resets of β are for, [N] of the base set: everything, unless a method knows better."""
        means = self.sets[BASE].parameters.tensors["means"]
        return torch.ones(len(means), dtype=torch.bool, device=means.device)

    def beta(self) -> Tensor:
        """β of the base set's primitives, [N] without gradients."""
        return self.sets[BASE].parameters.tensors["beta_logits"].detach()[:, 0].sigmoid()

    def initial_beta(self) -> float | None:
        return self.settings.initial_beta

    def initial_learning_rates(self) -> LearningRates:
        return replace(super().initial_learning_rates(), beta=self.settings.beta_lr * self.schedule.rate_scale)

    def training_state(self) -> dict[str, Any]:
        return super().training_state() | {"reflects": self.reflects, "hold_until": self._hold_until}

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        super().resume(scene, steps, state)
        self.reflects, self._hold_until = state["reflects"], state["hold_until"]

    def state(self) -> dict:
        return super().state() | {"reflects": self.reflects}

    def restore(self, state: dict) -> None:
        super().restore(state)
        self.reflects = state["reflects"]
