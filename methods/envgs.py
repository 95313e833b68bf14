"""EnvGS: the reflected color comes from a second set of surfels, traced along the reflected rays."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, Statistics
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, ENV, MethodCard

from .gaussians.densification import DensificationRule, spatial_criterion
from .gaussians.initialization import quantile_box, random_points_in_grid, random_points_on_sphere
from .gaussians.parameters import primitive_bytes
from .traced import TracedReflection, TracedSettings
from .training.pilot_run import SHORTEST_RUN
from .training.reflection_pilot import BOOTSTRAP, PLAIN, TrialOutcome, reflection_trial
from .training.schedule import DENSIFY_FLOOR, ENV_RESET_FLOOR, RECOVERY


@dataclass(frozen=True)
class EnvGSSettings(TracedSettings):
    env_grid: int = 8  # N: the box is divided into N³ cells
    env_per_cell: int = 5  # K: random primitives in each
    env_box_quantile: float = 0.995  # share of the points' range, on each axis, that the box covers
    env_box: float = 0.0  # half the edge of a cube around the origin as the box; 0: the scene's bounds, or by quantile
    env_far: float = 4.0  # radius of a sphere around the box that primitives start on too, × half its diagonal
    env_far_count: int = 2_000  # primitives on that sphere; 0: none
    env_initial_opacity: float = 0.05  # opacity that these start with
    env_from_points: bool = True  # primitives start at the scene's points too
    env_sh_from: int = 0  # step up to which the environment's color is the same from everywhere, SH degree 0
    env_position_scale: float = 5.0  # × the base set's position rate
    env_radius_power: int = 1  # its position rate grows with this power of the scene radius; released code: 2
    env_densify_every: int = 1_500  # steps between the environment's densifications
    env_densify_threshold: float = 1e-4  # gradient ½·t·∂L/∂mean above which its primitives are cloned or split
    env_max_primitives: int = 630_000  # largest environment; beyond, those of the least blending weight are pruned
    env_densify_until: int = 21_000  # step before which the environment's densification and opacity resets end
    env_opacity_reset_every: int = 6_000  # steps between the environment's opacity resets; 0: never

    reflection_trial: bool = False  # try before the first step what mirrored rays explain; if nothing, train as 2DGS


class EnvGS(TracedReflection):
    """EnvGS (Xie et al., CVPR 2025, Sec. 4): surfels, and a second set of them that only reflected rays meet."""

    card = MethodCard("envgs", "EnvGS", 40, "#CC0000")
    Settings: ClassVar[type] = EnvGSSettings
    settings: EnvGSSettings
    traced: ClassVar[str] = ENV
    captured: ClassVar[bool] = True

    def __init__(self, settings: EnvGSSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._box = (torch.zeros(3), torch.ones(3))
        self._trial: TrialOutcome | None = None

    def initialize(self, scene: Scene, steps: int) -> None:
        if self._trial is None and self.settings.reflection_trial and steps >= SHORTEST_RUN:
            self._trial = self._tried(scene)
        if self.plain:
            self.settings = replace(self.settings, **PLAIN)
            if self._budget is not None:
                self.limit(self._budget.budget)  # which one set now has for itself
        super().initialize(scene, steps)
        if self._trial is not None:
            self.notes.append(self._trial.sentence)
        self._box = environment_box(self.started_from, self.settings)

    @property
    def plain(self) -> bool:
        """Whether a trial has shown that nothing reflects: there is one set then, without β, trained as 2DGS."""
        return self._trial is not None and not self._trial.reflects

    def _tried(self, scene: Scene) -> TrialOutcome:
        # as what tells reflections apart was found: from random primitives alone, eight times as many
        s = self.settings
        settings = replace(
            s, reflection_trial=False, bootstrap=BOOTSTRAP, env_from_points=False, env_grid=2 * s.env_grid
        )
        mirrored, control = (self.for_trial(kind, settings) for kind in (EnvGS, AlongNormals))
        return reflection_trial(scene, mirrored, control)

    def start_reflection(self) -> None:
        """Make the environment: random primitives fill the box (Sec. 4.3), others lie where something is known to be.

        These are on a sphere around the box, the sky, where no point lies, and at the scene's points. If a few of these
        lie far away, the box is large, and what is near a mirror smaller than its cells.
        """
        s, (low, high) = self.settings, self._box
        inside = random_points_in_grid(low, high, s.env_grid, s.env_per_cell, self.generator)
        radius = s.env_far * 0.5 * float((high - low).norm())
        around = random_points_on_sphere((low + high) / 2, radius, s.env_far_count, self.generator)
        points = torch.cat([inside, around])
        colors = torch.rand(points.shape, generator=self.generator)
        if s.env_from_points:
            scene = self.started_from
            points = torch.cat([points, scene.points.to(points)])
            colors = torch.cat([colors, scene.point_colors.to(colors)])
        self.sets[ENV] = self.new_set(ENV, points, colors, s.env_initial_opacity, beta=None, orientation="random")

    def position_rate(self, name: str, step: int) -> float:
        rate, s = super().position_rate(name, step), self.settings
        if name == ENV:
            rate *= s.env_position_scale * self.radius ** (s.env_radius_power - 1)
        return rate

    def sh_from(self, name: str) -> int:
        return self.settings.env_sh_from if name == ENV else super().sh_from(name)

    def densification_criterion(self, name: str, statistics: Statistics, camera: Camera) -> Tensor:
        if name == ENV:
            return spatial_criterion(statistics)
        return super().densification_criterion(name, statistics, camera)

    def events(self, step: int) -> set[str]:
        s, schedule = self.settings, self.schedule
        happens = super().events(step)
        resets = {"stop": s.env_densify_until, "interval": s.env_opacity_reset_every, "floor": ENV_RESET_FLOOR}
        every = schedule.interval(s.env_densify_every, DENSIFY_FLOOR)
        if (
            not self._young(step)
            and not schedule.recovers(step, **resets)
            and schedule.densifies(step, start=s.bootstrap, stop=s.env_densify_until, every=every)
        ):
            happens.add("densify_env")
        if step > schedule.at(s.bootstrap) and schedule.resets(step, **resets):
            happens.add("reset_env_opacity")
        return happens

    def after_step(self, step: int, events: set[str]) -> None:
        super().after_step(step, events)
        if "densify_env" in events:
            self.densify(ENV)
        if "reset_env_opacity" in events:
            self.sets[ENV].reset_opacity()

    def densification_rule(self, name: str) -> DensificationRule:
        rule, s = super().densification_rule(name), self.settings
        if name == ENV:
            rule = replace(rule, gradient_threshold=s.env_densify_threshold)
        return rule

    def initial_beta(self) -> float | None:
        return None if self.plain else super().initial_beta()

    def primitive_bytes(self) -> dict[str, int]:
        if self.plain:
            return super().primitive_bytes()
        return super().primitive_bytes() | {ENV: primitive_bytes(self.axes, self.settings.sh_degree, has_beta=False)}

    def cap(self, name: str) -> int:
        return self.settings.env_max_primitives if name == ENV else super().cap(name)

    def own_bound(self, name: str) -> int:
        return self.cap(ENV) if name == ENV else super().own_bound(name)

    def phase(self, step: int) -> Hashable:
        return super().phase(step), self._young(step)

    def contributions(self, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """How much the picture would change without the set: to the base's color alone, or to the background."""
        if self._young(step):
            return {}
        color = rendering.color.detach()
        without = {BASE: self.background, ENV: rendering.layers[BASE].detach()}
        return {name: (color - other).abs().sum() for name, other in without.items()}

    def _young(self, step: int) -> bool:
        """Whether the environment is not there or so new that, as after a reset, nothing yet shows what is needed."""
        return step <= self.schedule.at(self.settings.bootstrap) + RECOVERY

    def training_state(self) -> dict[str, Any]:
        return super().training_state() | {"trial": None if self._trial is None else asdict(self._trial)}

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self._trial = None if state["trial"] is None else TrialOutcome(**state["trial"])
        super().resume(scene, steps, state)


class AlongNormals(EnvGS):
    """The control of a trial: its rays leave along the surface's normals, so that no view changes what they see."""

    def _reflected_rays(self, base: Rendering, camera: Camera, step: int | None) -> tuple[Tensor, Tensor, Tensor]:
        origins, mirrored, beta = super()._reflected_rays(base, camera, step)
        normal = unit(base.normal if self.settings.joint else base.normal.detach())
        return origins, torch.where(mirrored.any(dim=-1, keepdim=True), normal, 0.0), beta


def environment_box(scene: Scene, settings: EnvGSSettings) -> tuple[Tensor, Tensor]:
    """Corners [3], [3] of the box that the environment set starts in, world units.

    A cube around the origin where the settings or the scene's bounds give one, else by the points' quantile (Sec. 4.3).

    Raises:
        ValueError: `env_box` is negative.
    """
    if settings.env_box < 0:
        raise ValueError(f"env_box is {settings.env_box:g}, expected half the edge of a cube, or 0 for the quantile's")
    half_edge = settings.env_box or scene.bounds
    if not half_edge:
        return quantile_box(scene.points.float(), settings.env_box_quantile)
    corner = scene.points.float().new_full((3,), half_edge)
    return -corner, corner
