"""3DGS-DR: 3D Gaussians that reflect a cube map, a ray a pixel (3D Gaussian Splatting with Deferred Reflection).

Its normals are the Gaussians' shortest axes, and nothing but the reflected color teaches them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .envmap import EnvMap, EnvMapSettings
from .settings import PublishedSettings


# PublishedSettings stands first, so that all that every Gaussian method has is as in 3DGS's released code.
@dataclass(frozen=True)
class DeferredReflectionSettings(PublishedSettings, EnvMapSettings):
    """Steps are those of the authors' code, whose runs of 61,000 steps train for 31,000 of them without any event."""

    stretches: bool = False
    longest_run: int = 61_000
    sh_from: int = 10_000

    initial_orientation: str = "world"
    densify_until: int = 30_000
    min_opacity: float = 0.005

    normal_weight: float = 0.0
    mono_weight: float = 0.0
    perceptual_weight: float = 0.0

    initial_beta: float = 1e-3
    beta_lr: float = 6e-3
    beta_threshold: float = 0.0
    beta_reset_from: int = 1
    beta_reset: str = "raise"
    envmap_lr: float = 5e-2

    disturb_every: int = 1_000
    disturb_until: int = 24_000


class DeferredReflection(EnvMap):
    """Base color (1 − r)·c and reflected color r·E(d_ref), of maps of color, normal and reflection strength r.

    r is what the other methods here call β.
    """

    Settings: ClassVar[type] = DeferredReflectionSettings
    settings: DeferredReflectionSettings
    axes = 3

    def map_size(self, step: int) -> int:
        return self.settings.envmap_size
