"""Settings of a base set with reflections, and of what it reflects."""

from __future__ import annotations

from dataclasses import dataclass

from envgs_bench.core.trace import SH_DIRECTIONS

from ..settings import GaussianSettings, check_words


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


@dataclass(frozen=True)
class TracedSettings(ReflectionSettings):
    traced_sh_direction: str = "center"  # a traced primitive's color is seen toward its center, or along the ray: ray
    traced_near: float = 0.0  # hits nearer to a reflected ray's start are not drawn, world units
    traced_background: str = "scene"  # what reflected rays that pass everything see: the scene's background, or black


@dataclass(frozen=True)
class MapSettings(GaussianSettings):
    envmap_size: int = 128  # texels along a face's edge (EnvGS paper, App. B.1: 128 and 256)
    envmap_lr: float = 1e-2  # learning rate of the texels' logits


@dataclass(frozen=True)
class EnvMapSettings(ReflectionSettings, MapSettings):
    envmap_doublings: int = 3  # times that the map's size doubles in training, 0 to 3


def check_reflection(s: ReflectionSettings) -> None:
    """Raise a ValueError that names the setting of a value that means nothing."""
    check_words(s, {"beta_reset": ("lower", "raise")})
    if not 0 <= s.beta_filter < 1:
        raise ValueError(f"beta_filter is {s.beta_filter:g}, expected a share of at least 0 and below 1")
    if s.settling_interval < 1:
        raise ValueError(f"settling_interval is {s.settling_interval}, expected at least 1 × densify_every")
    if not 0 < s.initial_beta < 1:
        raise ValueError(f"initial_beta is {s.initial_beta:g}, expected a weight between 0 and 1")
    if s.supersampling < 1:
        raise ValueError(f"supersampling is {s.supersampling}, expected at least 1 ray along a pixel's side")
    if not 0 <= s.mono_floor <= 1:
        raise ValueError(f"mono_floor is {s.mono_floor:g}, expected a share from 0 to 1")


def check_traced(s: TracedSettings) -> None:
    """As `check_reflection`, of what traced sets have besides."""
    check_words(s, {"traced_sh_direction": SH_DIRECTIONS, "traced_background": ("scene", "black")})


def check_map(s: MapSettings) -> None:
    """As `check_reflection`, of what a cube map has besides."""
    if s.envmap_size < 2:
        raise ValueError(f"envmap_size is {s.envmap_size}, expected at least 2")
