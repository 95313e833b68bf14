"""3DGS: 3D Gaussians, rasterized (3D Gaussian Splatting). No normal losses: its primitives have no surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .gaussian_method import GaussianMethod
from .settings import GaussianSettings


@dataclass(frozen=True)
class ThreeDGSSettings(GaussianSettings):
    normal_weight: float = 0.0
    mono_weight: float = 0.0
    perceptual_weight: float = 0.0
    min_opacity: float = 0.005


class ThreeDGS(GaussianMethod):
    Settings: ClassVar[type] = ThreeDGSSettings
    axes = 3
