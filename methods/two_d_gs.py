"""2DGS: surfels, rasterized (2D Gaussian Splatting; EnvGS paper, Sec. 3), as its authors' released code trains it."""

from __future__ import annotations

from typing import ClassVar

from envgs_bench.parts import MethodCard

from .gaussian_method import GaussianMethod
from .settings import TwoDGSSettings


class TwoDGS(GaussianMethod):
    """2DGS (Huang et al., SIGGRAPH 2024): surfels, rasterized; reflections are color that depends on direction."""

    card = MethodCard("2dgs", "2DGS", 20, "#80E6B3", reflects=False)
    Settings: ClassVar[type] = TwoDGSSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True
