"""What a backend is: the functions that its module offers, and what they are given beside the public containers.

`backends` says which there are. Each offers `Backend`; and `Rasterizer`, `ColorKernels`, `ImageKernels` where it can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from torch import Tensor

from .camera import Camera
from .gaussians import GaussianSet
from .rendering import Rendering


@dataclass(frozen=True)
class Bvh:
    """A bounding volume hierarchy over one state of one set: build it again whenever the set changes."""

    backend: str
    primitives: int
    handle: Any


@dataclass(frozen=True)
class RasterizeOptions:
    background: Tensor  # [3]
    near: float
    low_pass: bool
    transmittance_min: float
    low_pass_statistics: bool = True
    color_statistics: bool = False
    removals: bool = False  # see removals.py


@dataclass(frozen=True)
class TraceOptions:
    background: Tensor  # [3]
    t_min: float
    transmittance_min: Tensor  # [R]
    sh_along_ray: bool  # else toward each primitive's center
    removals: bool = False  # see removals.py


class Backend(Protocol):
    """What every backend module offers."""

    def why_unavailable(self) -> str | None:
        """One sentence for the user, or None where it works."""

    def build_bvh(self, gaussians: GaussianSet) -> Bvh: ...

    def trace(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
    ) -> Rendering:
        """Rays [R, 3] drawn to one value a ray, [R, …]."""


@runtime_checkable
class Rasterizer(Protocol):
    """A backend that draws images too."""

    def rasterize(self, gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering: ...


@runtime_checkable
class ColorKernels(Protocol):
    """A backend that draws color alone faster, which nobody differentiates; elsewhere `rasterize` and `trace` serve."""

    def rasterize_color(
        self, gaussians: GaussianSet, camera: Camera, options: RasterizeOptions
    ) -> tuple[Tensor, Tensor]:
        """Color [H, W, 3] and alpha [H, W] of an image."""

    def trace_color(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
    ) -> tuple[Tensor, Tensor]:
        """Color [R, 3] and alpha [R] of rays [R, 3]."""


@runtime_checkable
class ImageKernels(Protocol):
    """A backend with its own code for what is computed from drawn images; elsewhere torch's formulas serve."""

    def reflect(
        self, image: Rendering, camera: Camera, offset: float, alpha_min: float, beta_min: Tensor | float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Origins [H, W, 3], directions [H, W, 3] and β [H, W]."""

    def depth_normals(self, depth: Tensor, camera: Camera) -> Tensor:
        """Normals [H, W, 3] from depths [H, W]."""

    def ssim_map(
        self, image: Tensor, target: Tensor, taps: tuple[float, ...], pad: int, c1: float, c2: float
    ) -> Tensor:
        """SSIM of every pixel and channel of images [H, W, C]."""
