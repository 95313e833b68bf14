"""Settings of methods with reflections, and of what is reflected. Nothing here imports torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..recipes import RecipeName
from ..settings import GaussianSettings, PublishedSettings, SitesGroup, ThreeDGSSettings
from ..validation import Amount, Count, Degree, Limit, Rate, Size, Steps, Weight

Doublings = Annotated[int, Field(ge=0, le=3)]


@dataclass(frozen=True)
class ReflectionSettings(GaussianSettings):
    """Settings of a base set with reflections. Steps are those of a run of 30,000."""

    group: ClassVar[str] = "reflection"

    rotation_lr_final: Rate = 3e-4  # learning rate of the quaternions at the end: low, as a mirror doubles each degree
    scale_lr: Rate = 1e-2

    normal_from: Steps = 7_000
    mono_weight: Amount = 0.05
    perceptual_weight: Amount = 0.0

    warm_up: Steps = 3_000  # steps with the base set alone
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
    envmap_lr: Rate = 1e-2  # learning rate of the texels


@dataclass(frozen=True)
class EnvMapSettings(ReflectionSettings, MapSettings):
    group: ClassVar[str] = "environment"
    envmap_doublings: Doublings = 3  # times that the map's size doubles in training, 0 to 3


@dataclass(frozen=True)
class EnvGSSettings(SitesGroup, ReflectionSettings):
    group: ClassVar[str] = "environment"
    env_start: Literal["random", "base"] = "random"  # at random, or as a copy of the base set, as it is then
    env_grid: Count = 8  # N: the box is divided into N³ cells, each with random primitives
    env_far_count: Limit = 2_000  # primitives on a sphere around the box; 0: none
    env_densify_every: Steps = 1_500  # steps between the environment's densifications
    env_densify_threshold: Amount = 1e-4  # gradient ½·t·∂L/∂mean above which its primitives are cloned or split
    env_max_primitives: Limit = 630_000  # largest environment; beyond, those of the least blending weight are pruned
    env_densify_until: Steps = 21_000  # step before which the environment's densification and opacity resets end
    env_opacity_reset_every: Steps = 6_000  # steps between the environment's opacity resets; 0: never
    planes: Literal["none", "masks", "photographs"] = "none"  # flat mirrors and panes, proposed by the one or the other
    reflection_pilot: bool = False  # a pilot run finds out what mirrored rays explain; if nothing, train as 2DGS

    @property
    def given(self) -> tuple[str, ...]:
        return super().given + (("masks",) if self.planes == "masks" else ())

    @property
    def normals_of_glass(self) -> bool:
        return self.planes != "masks"  # what shows in a pane lies behind it


# PublishedSettings stands first, so that all that every Gaussian method has is as in 3DGS's released code.
@dataclass(frozen=True)
class DeferredReflectionSettings(PublishedSettings, EnvMapSettings):
    """Steps are those of the authors' code, whose runs of 61,000 steps train for 31,000 of them without any event."""

    recipe: RecipeName = "3dgs_dr"

    densify_until: Steps = 30_000
    min_opacity: Amount = 0.005

    normal_weight: Amount = 0.0
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0

    initial_beta: Weight = 1e-3
    beta_lr: Rate = 6e-3
    envmap_doublings: Doublings = 0
    envmap_lr: Rate = 5e-2

    disturb_every: Steps = 1_000
    disturb_until: Steps = 24_000
    scope_radius: Amount = 0.0  # the ball that may reflect, × the cameras' mean distance from its middle; 0: everything

    @property
    def given(self) -> tuple[str, ...]:
        return super().given + (("ball",) if self.scope_radius > 0 else ())


# PublishedSettings stands first, so that all that every Gaussian method has is as in 2DGS's released code.
@dataclass(frozen=True)
class RefGaussianSettings(PublishedSettings, EnvMapSettings):
    """Steps are those of the authors' code, whose runs have 50,000. β is the metallic share m."""

    recipe: RecipeName = "ref_gaussian"

    sh_lr: Rate = 7.5e-3
    densify_until: Steps = 25_000

    normal_weight: Amount = 0.05
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0
    smooth_weight: Amount = 0.0  # weight of the edge-aware smoothness of normals
    smooth_until: Steps = 18_000  # step up to which that counts

    warm_up: Steps = 0
    shade_until: Steps = 18_000  # step up to which each surfel is shaded, not each pixel; then materials start anew
    indirect_from: Steps = 20_000  # step after which what hides the map from a pixel lights it
    initial_beta: Weight = 1e-2
    initial_roughness: Weight = 0.1  # roughness that surfels start with
    beta_lr: Rate = 5e-3
    roughness_lr: Rate = 5e-3  # learning rate of the roughnesses' logits
    albedo_lr: Rate = 7.5e-3  # learning rate of the albedos' logits
    indirect_lr: Rate = 7.5e-3  # learning rate of the indirect light's constant term; 1/20 of it for the others
    envmap_doublings: Doublings = 0

    disturb_every: Steps = 1_000
    disturb_until: Steps = 25_000


# PublishedSettings stands first, so that all that every Gaussian method has is as in 3DGS's released code.
@dataclass(frozen=True)
class GaussianShaderSettings(PublishedSettings, MapSettings):
    recipe: RecipeName = "gaussian_shader"
    sh_degree: Degree = 0  # no residual color, as in the authors' code
    min_opacity: Amount = 0.005

    normal_weight: Amount = 0.2
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0
    sparse_weight: Amount = 1e-3  # weight of the loss that makes alpha 0 or 1
    residual_weight: Amount = 1e-3  # weight of the lengths of what normals differ from the shortest axes by

    material_lr: Rate = 1.6e-2  # learning rate of colors, tints, roughnesses and normals at the start; log-linear
    material_lr_final: Rate = 1.6e-3  # learning rate of those and of the map at the end
    inner_lr: Rate = 2e-4  # learning rate of normals' residuals on the side that faces inward
    envmap_size: Size = 64
    envmap_lr: Rate = 1.6e-2


@dataclass(frozen=True)
class ThreeIGSSettings(ThreeDGSSettings):
    color: Literal["sh"] = "sh"  # the field's own
    sh_degree: Degree = 0

    diffuse_until: Steps = 3_000  # step up to which there is diffuse color alone
    brdf_lr: Rate = 2.5e-3  # learning rate of the Gaussians' features and roughnesses
    field_size: Size = 150  # samples of the illumination field along each axis
    field_lr: Rate = 2e-2  # learning rate of the field's planes and lines
    network_lr: Rate = 1e-3  # learning rate of what mixes the field's components, and of the network


# PublishedSettings stands first, so that all that every Gaussian method has is as in 2DGS's released code.
@dataclass(frozen=True)
class FeatureMapSettings(PublishedSettings):
    """What Ref-GS and RT-Splatting share: a map of features, a network, and surfaces of 2DGS."""

    normal_weight: Amount = 0.05
    mono_weight: Amount = 0.0

    warm_up: Steps = 0  # steps in which nothing is mirrored
    scope_radius: Amount = 0.0  # the ball that may mirror, × the cameras' mean distance from its middle; 0: everything
    map_levels: Count = 9  # of the map, whose first has 2^levels rows and twice as many columns
    feature_lr: Rate = 2e-3  # learning rate of roughnesses and features
    map_lr: Rate = 2e-3  # learning rate of the map
    network_lr: Rate = 5e-4  # learning rate of the network

    @property
    def given(self) -> tuple[str, ...]:
        return super().given + (("ball",) if self.scope_radius > 0 else ())


@dataclass(frozen=True)
class RefGSSettings(FeatureMapSettings):
    """Steps are those of the authors' code, whose runs have 31,000."""

    recipe: RecipeName = "ref_gs"
    sh_lr: Rate = 2e-3
    normal_from: Steps = 700
    perceptual_weight: Amount = 0.0
    warm_up: Steps = 700
    near_set: bool = False  # a set of what is mirrored nearby has the features (Ref-DGS), and not the surfaces
    albedo_lr: Rate = 5e-4  # learning rate of the albedos' logarithms


@dataclass(frozen=True)
class RTSplattingSettings(FeatureMapSettings):
    """Steps are those of the authors' code, whose runs have 61,000, or 31,000 on Ref-Real."""

    recipe: RecipeName = "rt_splatting"
    sh_lr: Rate = 2e-3
    normal_from: Steps = 700
    perceptual_weight: Amount = 0.01
    warm_up: Steps = 700  # in which masks count for nothing either; up to normal_from what lies behind is all there is
    occupancy_weight: Amount = 1e-3  # weight of the mean occupancy, which is minimized
    mask_weight: Amount = 0.01  # weight of what masks of the transparent say; 0: masks are not used
    reflectance_lr: Rate = 5e-3  # learning rate of the reflectances' logits
    transmission_lr: Rate = 1e-2  # learning rate of the transmissivities' logits

    @property
    def given(self) -> tuple[str, ...]:
        return super().given + (("masks",) if self.mask_weight > 0 else ())
