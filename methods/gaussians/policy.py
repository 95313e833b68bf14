"""SetPolicy: how one set of primitives is trained, from its start to its size limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

import torch
from torch import Tensor

from envgs_bench.core import Scene
from envgs_bench.parts import BASE

from ..settings import GaussianSettings, SitesGroup
from ..training.schedule import DENSIFY_FLOOR, RECOVERY, RESET_FLOOR, Every, Schedule, falls_on
from .densification import Criterion, DensificationRule, Oversized, screen_criterion
from .parameters import LearningRates, primitive_bytes
from .sites import COLUMNS, RATES, initial_sites

INITIAL_OPACITY = 0.1  # of the base set's primitives

DENSIFY_FROM = 500  # step of the reference run after which the base set is densified

SHAPES = 100_000  # primitives that the base set may have for what shapes and mirrors show, however small pictures are
PIXELS_OF_SHAPES = 10  # … if there are so many training pixels for each of these

SLOW_DENSIFICATIONS = 10  # that a span of slower growth has at least


@dataclass(frozen=True)
class Resets:
    """When a set's opacities are lowered, so that what no view needs can be pruned.

    Attributes:
        interval, stop, floor: as of `Schedule.recovers`; an interval of 0: never.
        start: step of this run after which they begin.
        besides: a step of this run at which there is one more; 0: none.
    """

    schedule: Schedule
    interval: int
    stop: int
    floor: int = RESET_FLOOR
    start: int = 0
    besides: int = 0

    def due(self, step: int) -> bool:
        regular = self.start < step < self.schedule.at(self.stop)
        return (regular and falls_on(step, self._interval())) or step == self.besides

    def recovers(self, step: int) -> bool:
        """Whether opacities, at this step, do not yet show what is needed: a reset was less than 100 steps before."""
        regular = self.schedule.recovers(step, stop=self.stop, interval=self.interval, floor=self.floor)
        return regular or 0 < self.besides < step < self.besides + RECOVERY

    def passed_first(self, step: int) -> bool:
        """Whether the first of the regular resets lies before a step."""
        return 0 < self._interval() < step

    def _interval(self) -> Fraction:
        return self.schedule.interval(self.interval, self.floor)


@dataclass(frozen=True)
class Start:
    """What a new primitive starts with.

    Attributes:
        orientation: of `initial_orientation`.
        beta: its blending weight in (0, 1); None in a set without β.
        scale: its standard deviations, × the distance to its neighbors.
        materials: the fields [count, K] of `count` primitives that are the method's own, by name.
        material_columns: K of each of these.
    """

    opacity: float
    orientation: str
    beta: float | None = None
    materials: Callable[[int], dict[str, Tensor]] = lambda count: {}
    material_columns: Mapping[str, int] = field(default_factory=dict)
    scale: float = 1.0


@dataclass(frozen=True)
class SetPolicy:
    """How the set `name` is trained. Steps of settings are those of a run of 30,000, on the run's `schedule`.

    Attributes:
        rates: Adam's step sizes of a new set.
        position_lr: the positions' rate × scene radius, at the run's start and end; log-linear between.
        position_scale, radius_power: × it, and the power of the radius that it grows with; 0: not at all.
        rotation_lr: the rotations' rate, at the run's start and end.
        sh_degree, sh_every, sh_from: the color's SH degree, steps until another one is added, from which step on.
        criterion: by which its primitives are cloned or split, [N] of one step's pass.
        rule: when they are; its size limit is what the settings let the set have at most, 0: any number.
        interval: steps of this run between two densifications, as of a step; 0: never.
        grows_from, grows_until: step after which, and before which it is densified.
        young_until: step of this run up to which the set is not there, or so new that nothing shows what is needed.
        oversized: what becomes of oversized primitives: split, or prune from the first opacity reset on.
        growth: by gradients above a threshold, or by moving primitives until a size limit is full (`relocation`).
        size_limit: what the settings name; 0: none.
    """

    name: str
    schedule: Schedule
    start: Start
    rates: LearningRates
    position_lr: tuple[float, float]
    rotation_lr: tuple[float, float]
    sh_degree: int
    sh_every: int
    sh_from: int
    criterion: Criterion
    rule: DensificationRule
    interval: Callable[[int], Fraction]
    grows_from: int
    grows_until: int
    resets: Resets
    size_limit: int
    position_scale: float = 1.0
    radius_power: int = 1
    oversized: str = "split"
    young_until: int = 0
    growth: str = "gradient"

    def primitive_bytes(self, axes: int) -> int:
        """Bytes of one primitive as float32."""
        own = 4 * sum(self.start.material_columns.values())
        return primitive_bytes(axes, self.sh_degree, self.start.beta is not None) + own

    def with_materials(
        self, materials: Callable[[int], dict[str, Tensor]], columns: Mapping[str, int], rates: Mapping[str, float]
    ) -> SetPolicy:
        """The same for primitives with fields of a method's own: `Start`'s materials and columns, and their rates."""
        start = replace(self.start, materials=materials, material_columns=columns)
        return replace(self, start=start, rates=replace(self.rates, materials=rates))

    def position_rate(self, step: int, radius: float) -> float:
        """World units, in a scene of that radius."""
        rate = self.schedule.rate(step, *self.position_lr) * self.schedule.rate_scale * radius
        return rate * (self.position_scale * radius ** (self.radius_power - 1))

    def rotation_rate(self, step: int) -> float:
        return self.schedule.rate(step, *self.rotation_lr) * self.schedule.rate_scale

    def sh_degree_at(self, step: int) -> int:
        every, since = self.schedule.at(self.sh_every), step - self.schedule.at(self.sh_from)
        if since <= 0:
            return 0
        return min(self.sh_degree, since // every) if every else self.sh_degree

    def oversized_at(self, step: int) -> Oversized:
        """What a densification after `step` does with what is oversized; 3DGS's pruning waits for the first reset."""
        if self.oversized == "split":
            return "split"
        return "prune" if self.resets.passed_first(step) else "keep"

    @property
    def fills_limit(self) -> bool:
        """Whether the set grows until its size limit is full, and not where gradients are above a threshold."""
        return self.growth != "gradient"

    def is_young(self, step: int) -> bool:
        return step <= self.young_until

    def densification(self, action: Callable[[int], object]) -> Every:
        """The event of the set's densifications: none while nothing shows what is needed."""
        at = self.schedule.at
        return Every(
            f"densify_{self.name}",
            action,
            self.interval,
            at(self.grows_from),
            at(self.grows_until),
            unless=lambda step: self.is_young(step) or self.resets.recovers(step),
        )

    def opacity_reset(self, action: Callable[[int], object]) -> Every:
        return Every(f"reset_{self.name}_opacity", action, also=self.resets.due, recovery=self.resets.floor)


def zeros(columns: Mapping[str, int], count: int) -> dict[str, Tensor]:
    """Fields [count, K] of 0 by name, of so many columns each: `Start.materials`, once the columns are given."""
    return {name: torch.zeros(count, size) for name, size in columns.items()}


def base_policy(
    s: GaussianSettings, schedule: Schedule, scene: Scene | None, *, start: Start, rates: LearningRates
) -> SetPolicy:
    """The policy of what cameras see; without a scene, that of a method that no training has started."""
    most = s.max_primitives if scene is None else max_base_primitives(s, scene)
    by_gradient = s.rule.growth == "gradient"
    sites = isinstance(s, SitesGroup) and s.color == "sites"
    if sites:
        start = replace(start, materials=initial_sites, material_columns=COLUMNS)
        rates = replace(rates, materials={name: rate * schedule.rate_scale for name, rate in RATES.items()})
    return SetPolicy(
        name=BASE,
        schedule=schedule,
        start=replace(start, scale=s.rule.initial_scale),
        rates=rates,
        position_lr=(s.position_lr, s.position_lr_final),
        rotation_lr=(s.rotation_lr, s.rotation_lr_final),
        sh_degree=0 if sites else s.sh_degree,
        sh_every=s.rule.sh_every,
        sh_from=s.rule.sh_from,
        criterion=screen_criterion,
        rule=densification_rule(s, most),
        interval=regular(schedule, s.densify_every),
        grows_from=DENSIFY_FROM,
        grows_until=s.densify_until,
        resets=opacity_resets(s, schedule, scene) if by_gradient else Resets(schedule, 0, s.densify_until),
        size_limit=s.max_primitives,
        oversized=s.rule.oversized,
        growth=s.rule.growth,
        position_scale=s.rule.position_radius or 1.0,
        radius_power=0 if s.rule.position_radius else 1,
    )


def regular(schedule: Schedule, interval: int) -> Callable[[int], Fraction]:
    """The interval of a run of 30,000 between densifications, the same at every step."""
    return lambda step: schedule.interval(interval, DENSIFY_FLOOR)


def slowed(usual: Callable[[int], Fraction], times: int, after: int, until: int) -> Callable[[int], Fraction]:
    """An interval between densifications, `times` as long in a span of steps, or as leaves it ten of them."""

    def interval(step: int) -> Fraction:
        every = usual(step)
        if every == 0 or not after < step <= until:
            return every
        longest = (until - after) // (SLOW_DENSIFICATIONS * every)
        return every * max(1, min(times, longest))

    return interval


def densification_rule(s: GaussianSettings, most: int) -> DensificationRule:
    """When a primitive is cloned, split or removed, in a set of at most so many."""
    rule = s.rule
    return DensificationRule(
        s.densify_threshold,
        s.min_opacity,
        most,
        s.min_coverage,
        rule.min_views,
        rule.max_growth,
        parts_weigh=rule.parts_weigh,
    )


def initial_rates(s: GaussianSettings, schedule: Schedule) -> LearningRates:
    """Adam's step sizes of a new set."""
    scale = schedule.rate_scale
    return LearningRates(
        position=s.position_lr * scale,
        sh_dc=s.sh_lr * scale,
        sh_rest=s.sh_lr * scale / 20,
        opacity=s.opacity_lr,
        scale=s.scale_lr,
        rotation=s.rotation_lr * scale,
    )


def max_base_primitives(settings: GaussianSettings, scene: Scene) -> int:
    """The most primitives that the base set may have; 0: any number.

    Not fewer than it starts with. Small pictures from many sides show shapes that need more than their size says.
    """
    if settings.primitives_per_pixel <= 0:
        return settings.max_primitives
    pixels = sum(view.camera.width * view.camera.height for view in scene.train)
    for_detail = int(settings.primitives_per_pixel * pixels / len(scene.train))
    bound = max(len(scene.points), for_detail, min(SHAPES, pixels // PIXELS_OF_SHAPES))
    return min(settings.max_primitives or bound, bound)


def opacity_resets(s: GaussianSettings, schedule: Schedule, scene: Scene | None) -> Resets:
    """With 3DGS's reset over a white background, of what has been put before it for nothing.

    A run that is too short for any other reset has none of these either.
    """
    on_white = scene is not None and bool((scene.background == 1).all())
    resets = 0 < schedule.interval(s.opacity_reset_every, RESET_FLOOR) < schedule.at(s.densify_until)
    besides = schedule.at(DENSIFY_FROM) if s.rule.reset_on_white and on_white and resets else 0
    return Resets(schedule, s.opacity_reset_every, s.densify_until, besides=besides)
