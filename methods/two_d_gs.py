"""2DGS: surfels, rasterized (2D Gaussian Splatting; EnvGS paper, Sec. 3)."""

from __future__ import annotations

from .gaussian_method import GaussianMethod


class TwoDGS(GaussianMethod):
    axes = 2
