"""Settings that Gaussian methods share, in groups: a class a group, and a field belongs to the class that brings it.

Settings of methods with reflections are in `lighting/settings.py`. Neither imports torch: runs are composed without it.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeVar

from .recipes import RecipeName, Rules, rules_of
from .validation import Amount, Degree, Limit, Rate, Steps, checked

LEARNING_RATES = ("_lr", "_lr_final")  # how the names of settings end that are learning rates

BackendName = Literal["auto", "cpu", "cuda", "torch"]  # of the core

OWN = "own"  # the group of what a method has for itself

S = TypeVar("S", bound="RunGroup")


@dataclass(frozen=True)
class RunGroup:
    """By which rules a method trains, and where that is computed."""

    group: ClassVar[str] = "run"
    recipe: RecipeName = "ours"  # whose rules: `envgs-bench list recipes`
    rules: dict[str, Any] = field(default_factory=dict, hash=False)  # single rules that are otherwise, by name
    backend: BackendName = "auto"  # backend of the core

    def __post_init__(self) -> None:
        given = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        for name, value in checked(type(self), given, "").items():
            object.__setattr__(self, name, value)  # as its type says: 1000 where 1e3 was given
        _ = self.rule  # refuses a rule that there is not

    @cached_property
    def rule(self) -> Rules:
        """The rules in force."""
        return rules_of(self.recipe, self.rules)

    def ruled(self: S, **rules: Any) -> S:
        """These settings with other rules."""
        return dataclasses.replace(self, rules={**self.rules, **rules})


@dataclass(frozen=True)
class RatesGroup:
    """Adam's step sizes."""

    group: ClassVar[str] = "rates"
    position_lr: Rate = 1.6e-4  # positions' learning rate × scene radius at the start; log-linear to position_lr_final
    position_lr_final: Rate = 1.6e-6  # positions' learning rate × scene radius at the end
    sh_lr: Rate = 2.5e-3  # learning rate of the spherical harmonics' constant term; 1/20 of it for the others
    opacity_lr: Rate = 5e-2  # learning rate of the opacities' logits
    scale_lr: Rate = 5e-3  # learning rate of the scales' logarithms
    rotation_lr: Rate = 1e-3  # learning rate of the quaternions at the start; log-linear to rotation_lr_final
    rotation_lr_final: Rate = 1e-3  # learning rate of the quaternions at the end


@dataclass(frozen=True)
class GrowthGroup:
    """How large the base set gets. Steps are those of a run of 30,000 (see `Schedule`)."""

    group: ClassVar[str] = "growth"
    sh_degree: Degree = 2  # degree of the view-dependent color's spherical harmonics, 0 to 3
    densify_until: Steps = 25_000  # step before which densification and opacity resets end
    densify_every: Steps = 300  # steps between the base set's densifications
    densify_threshold: Amount = 2e-4  # gradient of the projected center, in half images
    min_coverage: Amount = 1.0  # pixels that a primitive must fill, on average over its views, to be cloned or split
    min_opacity: Amount = 0.05  # primitives below are pruned
    max_primitives: Limit = 1_800_000  # largest base set; beyond, those of the least blending weight are pruned; 0: any
    primitives_per_pixel: Amount = 0.75  # the base set has at most so many for each pixel of one view; 0: no bound
    opacity_reset_every: Steps = 3_000  # steps between the base set's opacity resets; 0: never
    prune_error: Amount = 0.0  # a pruning removes what adds so much to the training views' squared error; 0: none
    prune_from: Steps = 21_000  # step after which there are prunings, of all sets together
    prune_by: Literal["importance", "weight", "opacity"] = "importance"  # what goes first; weight: by Σ of T·α


@dataclass(frozen=True)
class SitesGroup:
    """What a primitive's color is made of, where a method has the choice."""

    group: ClassVar[str] = "growth"
    color: Literal["sh", "sites"] = "sh"  # sites: 8 cells of the sphere, each with its color, in place of sh_degree


@dataclass(frozen=True)
class LossesGroup:
    """What is minimized beside the photometric error."""

    group: ClassVar[str] = "losses"
    normal_weight: Amount = 0.04  # weight of L_norm, rendered normals against those of the depth map
    normal_from: Steps = 0  # step after which L_norm counts
    mono_weight: Amount = 0.01  # weight of L_mono, rendered normals against the view's own where it has any
    perceptual_weight: Amount = 0.01  # weight of L_perc, where the harness provides it
    exposure: Literal["none", "affine"] = "none"  # affine: a map of color a training view, learned along; none in tests


@dataclass(frozen=True)
class GaussianSettings(LossesGroup, GrowthGroup, RatesGroup, RunGroup):
    """Settings that all Gaussian methods share."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule.growth != "gradient" and not (self.max_primitives or self.primitives_per_pixel):
            growth = self.rule.growth
            raise ValueError(f"growth {growth} fills a size limit: set max_primitives or primitives_per_pixel above 0")

    @property
    def given(self) -> tuple[str, ...]:
        """What is used of the data besides photographs, poses and points, where these have it: GIVEN's keys."""
        return ("normals",) if self.mono_weight > 0 else ()

    @property
    def normals_of_glass(self) -> bool:
        """Whether the views' normals are learned of what their masks call transmissive too."""
        return True


@dataclass(frozen=True)
class PublishedSettings(GaussianSettings):
    """What 3DGS and 2DGS share of their released code: its colors and its growth without bound."""

    sh_degree: Degree = 3
    densify_until: Steps = 15_000
    densify_every: Steps = 100
    min_coverage: Amount = 0.0
    max_primitives: Limit = 0
    primitives_per_pixel: Amount = 0.0


@dataclass(frozen=True)
class ThreeDGSSettings(SitesGroup, PublishedSettings):
    recipe: RecipeName = "3dgs"

    min_opacity: Amount = 0.005
    normal_weight: Amount = 0.0
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0


@dataclass(frozen=True)
class TwoDGSSettings(SitesGroup, PublishedSettings):
    """Normals are held to the depth map alone, and pictures are compared pixel by pixel."""

    recipe: RecipeName = "2dgs"

    normal_weight: Amount = 0.05
    normal_from: Steps = 7_000
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0


def make_settings(settings_type: type, values: Mapping[str, Any], where: str) -> Any:
    """`values` as an instance of the dataclass `settings_type`; raises ValueError as `checked` does."""
    accepted = checked(settings_type, values, where)
    if issubclass(settings_type, RunGroup):
        checked(Rules, accepted.get("rules", {}), f"{where}rules.")
    return settings_type(**accepted)


def quickness(settings: Any) -> float:
    """How quickly a method learns beside its own rates: the median of its rates over their defaults, at most 1.

    So a recipe that lowers one rate is not slow, and one that lowers all of them is. 1 where there are no rates.
    """
    own, usual = dataclasses.asdict(settings), dataclasses.asdict(type(settings)())
    ratios = [own[name] / usual[name] for name in own if name.endswith(LEARNING_RATES) and usual[name] > 0]
    return min(1.0, statistics.median(ratios or [1.0]))


def setting_groups(settings_type: type) -> dict[str, list[str]]:
    """The fields of a settings dataclass by the group of the class that brings them; OWN where that names none."""
    found: dict[str, list[str]] = {}
    known: set[str] = set()
    fields = {each.name for each in dataclasses.fields(settings_type)}
    for owner in reversed(settings_type.__mro__):
        if new := [name for name in vars(owner).get("__annotations__", {}) if name in fields - known]:
            found.setdefault(vars(owner).get("group", OWN), []).extend(new)
            known.update(new)
    return found
