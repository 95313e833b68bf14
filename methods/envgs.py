"""EnvGS: the reflected color comes from a second set of surfels, traced along the reflected rays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, Statistics
from envgs_bench.parts import ENV

from .densification import DensificationRule, spatial_criterion
from .initialization import quantile_box, random_points_in_grid
from .reflection import ReflectionSettings
from .schedule import DENSIFY_FLOOR, ENV_RESET_FLOOR, RECOVERY
from .traced import TracedReflection

PAPER_GRID = 32  # N of Sec. 4.3


@dataclass(frozen=True)
class EnvGSSettings(ReflectionSettings):
    env_grid: int = 0  # N: the box is divided into N³ cells (paper: 32); 0: as many primitives as points, N ≤ 32
    env_per_cell: int = 5  # K: random primitives in each
    env_box_quantile: float = 0.995  # share of the points' range, on each axis, that the box covers
    env_box: float = 0.0  # half the edge of a cube around the origin as the box; 0: the scene's bounds, or by quantile
    env_densify_every: int = 500  # steps between the environment's densifications
    env_densify_threshold: float = 1e-4  # of ½·t·∂L/∂mean
    env_max_primitives: int = 630_000  # those of the least blending weight go
    env_opacity_reset_every: int = 6_000  # steps between the environment's opacity resets; 0: never


class EnvGS(TracedReflection):
    """EnvGS (paper, Sec. 4)."""

    Settings: ClassVar[type] = EnvGSSettings
    settings: EnvGSSettings
    traced: ClassVar[str] = ENV

    def __init__(self, settings: EnvGSSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._box = (torch.zeros(3), torch.ones(3))
        self._points = 0

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.sets.pop(ENV, None)
        self._points = len(scene.points)
        self._box = environment_box(scene, self.settings)

    def start_reflection(self) -> None:
        s = self.settings
        grid = s.env_grid or min(PAPER_GRID, max(1, round((self._points / s.env_per_cell) ** (1 / 3))))
        points = random_points_in_grid(*self._box, grid, s.env_per_cell, self.generator)
        colors = torch.rand(points.shape, generator=self.generator)
        self.sets[ENV] = self.new_set(points, colors, self.densification_rule(ENV), None, self.generator)

    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        rendering = self.trace_reflection(origins, directions, step)
        return rendering.color, {ENV: rendering.statistics}

    def densification_criterion(self, name: str, statistics: Statistics, camera: Camera) -> Tensor:
        if name == ENV:
            return spatial_criterion(statistics)
        return super().densification_criterion(name, statistics, camera)

    def events(self, step: int) -> set[str]:
        s, schedule = self.settings, self.schedule
        happens = super().events(step)
        resets = {"stop": s.densify_until, "interval": s.env_opacity_reset_every, "floor": ENV_RESET_FLOOR}
        every = schedule.interval(s.env_densify_every, DENSIFY_FLOOR)
        young = step <= schedule.at(s.bootstrap) + RECOVERY  # as after a reset, opacities say nothing about need
        if (
            not young
            and not schedule.recovers(step, **resets)
            and schedule.densifies(step, start=s.bootstrap, stop=s.densify_until, every=every)
        ):
            happens.add("densify_env")
        if step > schedule.at(s.bootstrap) and schedule.resets(step, **resets):
            happens.add("reset_env_opacity")
        return happens

    def after_step(self, step: int, events: set[str]) -> None:
        super().after_step(step, events)
        if "densify_env" in events:
            self.sets[ENV].densify(self.radius, self.generator)
        if "reset_env_opacity" in events:
            self.sets[ENV].reset_opacity()

    def densification_rule(self, name: str) -> DensificationRule:
        rule, s = super().densification_rule(name), self.settings
        if name == ENV:
            rule = replace(rule, gradient_threshold=s.env_densify_threshold, max_primitives=s.env_max_primitives)
        return rule


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
