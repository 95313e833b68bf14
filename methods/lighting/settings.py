"""Settings of a base set with reflections, and of what it reflects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from ..settings import GaussianSettings
from ..validation import Amount, Count, Rate, Size, Steps, Weight

Doublings = Annotated[int, Field(ge=0, le=3)]


@dataclass(frozen=True)
class ReflectionSettings(GaussianSettings):
    """Settings of a base set with reflections. Steps are those of a run of 30,000."""

    group: ClassVar[str] = "reflection"

    rotation_lr_final: Rate = 1e-4  # learning rate of the quaternions at the end: low, as a mirror doubles each degree
    scale_lr: Rate = 1e-2

    normal_from: Steps = 7_000
    mono_weight: Amount = 0.05
    perceptual_weight: Amount = 0.0

    densify_until: Steps = 18_000
    densify_every: Steps = 300
    min_coverage: Amount = 1.5
    pixels_per_primitive: Amount = 7.0

    bootstrap: Steps = 3_000  # steps with the base set alone
    joint: bool = True  # reflected rays pass gradients on to the base set's normals and positions
    initial_beta: Weight = 0.1  # β that base primitives start with: 1e-3 where little reflects, to 0.1 where much does
    beta_lr: Rate = 1e-2  # learning rate of β's logits
    beta_filter: Annotated[float, Field(ge=0, lt=1)] = 0.0  # share of an image's pixels, of the smallest β, not traced
    supersampling: Count = 1  # reflected rays along each side of a pixel: 2 are four a pixel

    disturb_every: Steps = 0  # steps between color sabotages and normal propagations; 0: never
    disturb_until: Steps = 18_000  # step up to which disturbances go on, and densifications are settling_interval apart
    sabotage: bool = True  # disturb the base color of primitives that do not reflect
    propagate: bool = True  # enlarge primitives that reflect, so that their normals spread


@dataclass(frozen=True)
class MapSettings(GaussianSettings):
    group: ClassVar[str] = "environment"
    envmap_size: Size = 128  # texels along a face's edge (EnvGS paper, App. B.1: 128 and 256)
    envmap_lr: Rate = 1e-2  # learning rate of the texels' logits


@dataclass(frozen=True)
class EnvMapSettings(ReflectionSettings, MapSettings):
    group: ClassVar[str] = "environment"
    envmap_doublings: Doublings = 3  # times that the map's size doubles in training, 0 to 3
