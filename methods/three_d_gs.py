"""3DGS: 3D Gaussians, rasterized, as its authors' released code trains them (3D Gaussian Splatting).

No normal losses: its primitives have no surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from envgs_bench.parts import MethodCard

from .gaussian_method import GaussianMethod
from .recipes import RecipeName
from .settings import PublishedSettings
from .validation import Amount


@dataclass(frozen=True)
class ThreeDGSSettings(PublishedSettings):
    recipe: RecipeName = "3dgs"

    min_opacity: Amount = 0.005
    normal_weight: Amount = 0.0
    mono_weight: Amount = 0.0
    perceptual_weight: Amount = 0.0


class ThreeDGS(GaussianMethod):
    """3DGS (Kerbl et al., SIGGRAPH 2023): 3D Gaussians, rasterized; reflections are color that depends on direction."""

    card = MethodCard("3dgs", "3DGS", 10, "#336666", reflects=False)
    Settings: ClassVar[type] = ThreeDGSSettings
    axes = 3
    cuda_graph: ClassVar[bool] = True
