"""EnvGS: the reflected color comes from a second set of surfels, traced along the reflected rays."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import ClassVar, Literal

import torch
from torch import Tensor

from envgs_bench.core import Scene
from envgs_bench.parts import BASE, ENV, MethodCard

from .gaussian_method import GaussianMethod, fresh
from .gaussians.densification import camera_criterion, spatial_criterion
from .gaussians.initialization import box_inside, quantile_box, random_points_in_grid, random_points_on_sphere
from .gaussians.model import GaussianModel
from .gaussians.policy import Resets, SetPolicy, regular
from .gaussians.trained_set import TrainedSet
from .lighting.disturbance import Disturbance, reflecting_policy
from .lighting.light_map import far_map
from .lighting.planes import Planes
from .lighting.reflection import BaseCopy, Origin, Reflection, Traced
from .lighting.settings import EnvGSSettings
from .training.pilot_run import SHORTEST_RUN
from .training.reflection_pilot import PLAIN, WARM_UP, ReflectionOutcome, reflection_pilot
from .training.schedule import ENV_RESET_FLOOR, RECOVERY, Schedule

REFLECTION = "reflection"  # in `found`: what the pilot run on reflections has shown
PLANES = "planes"  # in `parts`: flat mirrors and panes
PER_CELL = 5  # K: random primitives in each cell of the box
BOX_QUANTILE = 0.995  # share of the points' range, on each axis, that the box covers
INSIDE_QUANTILE = 0.99  # the same of points that are held whole, where the released code is followed
FAR = 4.0  # radius of a sphere around the box that primitives start on too, × half its diagonal


class EnvGS(GaussianMethod):
    """EnvGS (Xie et al., CVPR 2025, Sec. 4): surfels, and a second set of them that only reflected rays meet."""

    card = MethodCard("envgs", "EnvGS", 40, "#CC0000")
    Settings: ClassVar[type] = EnvGSSettings
    settings: EnvGSSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: EnvGSSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        compose(self, settings)

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        base = reflecting_policy(self.settings, schedule, scene)
        if is_plain(self):
            return {BASE: replace(base, start=replace(base.start, beta=None))}
        return {BASE: base, ENV: environment_policy(self.settings, schedule, base)}

    def initialize(self, scene: Scene, steps: int) -> None:
        if REFLECTION not in self.found and self.settings.reflection_pilot and steps >= SHORTEST_RUN:
            self.found[REFLECTION] = asdict(tried_reflections(self, scene))
        if is_plain(self):
            compose(self, replace(self.settings, **PLAIN))
            if self.model.budget is not None:
                self.limit(self.model.budget.budget)  # which one set now has for itself
        super().initialize(scene, steps)
        if REFLECTION in self.found:
            self.notes.append(ReflectionOutcome(**self.found[REFLECTION]).sentence)


def compose(method: EnvGS, settings: EnvGSSettings) -> None:
    """Make the method's parts for these settings, in place of those that it has."""
    method.settings = method.model.settings = settings
    method.model.policies = method.policies(method.model.schedule, None)
    origin = BaseCopy() if settings.env_start == "base" else Environment(settings, method.generator)
    light = Traced(method.model, settings, ENV, origin)
    method.reflection = Reflection(method.model, settings, light)
    method.parts = {"reflection": method.reflection, "disturbance": Disturbance(method.model, settings)}
    if not is_plain(method):
        method.parts |= far_map(method.model, settings, light)
    if settings.planes != "none":
        planes = method.parts[PLANES] = Planes(method.model, settings)
        method.reflection.over = planes.over


def is_plain(method: EnvGS) -> bool:
    """Whether a pilot run has shown that nothing reflects: there is one set then, without β, trained as 2DGS."""
    return REFLECTION in method.found and not ReflectionOutcome(**method.found[REFLECTION]).reflects


class Environment(Origin):
    """Where environment primitives start: at random in a box, on a sphere around it, and at the scene's points.

    The sphere is the sky, where no point lies. If a few points lie far away, the box is large, and what is near a
    mirror smaller than its cells.
    """

    def __init__(self, settings: EnvGSSettings, generator: torch.Generator) -> None:
        self._settings, self._generator = settings, generator

    def start(self, scene: Scene) -> None:
        self._scene, self._box = scene, environment_box(scene, self._settings.rule.env_box)

    def made(self, model: GaussianModel, name: str) -> TrainedSet:
        return model.new_set(name, *self.points())

    def points(self) -> tuple[Tensor, Tensor]:
        """Points [N, 3] in the world frame, and colors [N, 3] in [0, 1]."""
        s, (low, high) = self._settings, self._box
        inside = random_points_in_grid(low, high, s.env_grid, PER_CELL, self._generator)
        radius = FAR * 0.5 * float((high - low).norm())
        around = random_points_on_sphere((low + high) / 2, radius, s.env_far_count, self._generator)
        points = torch.cat([inside, around])
        colors = torch.rand(points.shape, generator=self._generator)
        if s.rule.env_from_points:
            points = torch.cat([points, self._scene.points.to(points)])
            colors = torch.cat([colors, self._scene.point_colors.to(colors)])
        return points, colors


def environment_policy(s: EnvGSSettings, schedule: Schedule, base: SetPolicy) -> SetPolicy:
    """The base's, but for what is the environment's own; it does not grow more slowly while reflections settle."""
    start = schedule.at(s.warm_up)
    orientation = "positive" if s.rule.initial_orientation == "positive" else "random"
    return replace(
        base,
        name=ENV,
        start=replace(base.start, opacity=s.rule.env_initial_opacity, orientation=orientation, beta=None),
        position_scale=s.rule.env_position_scale,
        radius_power=s.rule.env_radius_power,
        sh_from=s.rule.env_sh_from,
        criterion=camera_criterion if s.rule.env_gradient == "camera" else spatial_criterion,
        rule=replace(base.rule, gradient_threshold=s.env_densify_threshold, max_primitives=s.env_max_primitives),
        interval=regular(schedule, s.env_densify_every),
        grows_from=s.warm_up,
        grows_until=s.env_densify_until,
        resets=Resets(schedule, s.env_opacity_reset_every, s.env_densify_until, ENV_RESET_FLOOR, start),
        size_limit=s.env_max_primitives,
        oversized="split",
        growth="gradient",
        young_until=start + RECOVERY,
    )


def tried_reflections(method: EnvGS, scene: Scene) -> ReflectionOutcome:
    """What a pilot run finds of the scene: from random primitives alone, eight times as many, as it was tuned."""
    s = method.settings
    settings = replace(s, reflection_pilot=False, warm_up=WARM_UP, env_grid=2 * s.env_grid)
    settings = settings.ruled(env_from_points=False)
    mirrored, control = (fresh(method, settings) for _ in range(2))
    assert control.reflection is not None
    control.reflection.rays_along = "normal"
    return reflection_pilot(scene, mirrored, control)


def environment_box(scene: Scene, box: Literal["central", "inside"] = "central") -> tuple[Tensor, Tensor]:
    """Corners [3], [3] of the box that the environment set starts in, world units.

    A cube around the origin where the scene's bounds are known, else by the points' quantile (Sec. 4.3): the central
    99.5 % of each axis, or what holds the points inside the central 99 % of all axes, as its released code reads it.
    """
    if not scene.bounds:
        positions = scene.points.float()
        return quantile_box(positions, BOX_QUANTILE) if box == "central" else box_inside(positions, INSIDE_QUANTILE)
    corner = scene.points.float().new_full((3,), scene.bounds)
    return -corner, corner
