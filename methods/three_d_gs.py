"""3DGS: 3D Gaussians, rasterized, as its authors' released code trains them (3D Gaussian Splatting).

No normal losses: its primitives have no surface.
"""

from __future__ import annotations

from typing import ClassVar

from envgs_bench.parts import MethodCard

from .gaussian_method import GaussianMethod
from .settings import ThreeDGSSettings


class ThreeDGS(GaussianMethod):
    """3DGS (Kerbl et al., SIGGRAPH 2023): 3D Gaussians, rasterized; reflections are color that depends on direction."""

    card = MethodCard("3dgs", "3DGS", 10, "#336666", reflects=False)
    Settings: ClassVar[type] = ThreeDGSSettings
    axes = 3
    cuda_graph: ClassVar[bool] = True
