"""The extension built from this folder's C++; see bindings.cpp."""

from typing import Any

from torch import Tensor

pixel_lanes: int  # pixels of a row that the rasterizer takes at once

class RasterPass:
    def forward(self, planes: tuple[Tensor, ...], hits: Tensor, weights: Tensor) -> None: ...
    def backward(
        self, planes: tuple[Tensor, ...], gradients: tuple[Tensor | None, ...], result: tuple[Tensor, ...]
    ) -> None: ...

def raster_pass(gaussians: tuple[Tensor, ...], *camera_and_options: Any) -> RasterPass: ...

class Bvh:
    def __init__(self, gaussians: tuple[Tensor, ...], threads: int) -> None: ...

class TracePass:
    def __init__(self, bvh: Bvh, gaussians: tuple[Tensor, ...], *rays_and_options: Any) -> None: ...
    def forward(self, planes: tuple[Tensor, ...], hits: Tensor, weights: Tensor, keep_hits: bool) -> None: ...
    def backward(
        self,
        planes: tuple[Tensor, ...],
        gradients: tuple[Tensor | None, ...],
        result: tuple[Tensor, ...],
        origins: Tensor,
        directions: Tensor,
    ) -> None: ...
