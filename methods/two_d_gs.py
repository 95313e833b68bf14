"""2DGS: surfels, rasterized (2D Gaussian Splatting; EnvGS paper, Sec. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .gaussian_method import GaussianMethod
from .settings import GaussianSettings


@dataclass(frozen=True)
class TwoDGSSettings(GaussianSettings):
    """As published: normals are held to the depth map alone, and pictures are compared pixel by pixel."""

    normal_weight: float = 0.05
    normal_from: int = 7_000
    mono_weight: float = 0.0
    perceptual_weight: float = 0.0


class TwoDGS(GaussianMethod):
    Settings: ClassVar[type] = TwoDGSSettings
    axes = 2
