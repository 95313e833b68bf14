"""The native backend: C++ on all cores, SIMD. The default where there is no GPU."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..camera import Camera
from ..contract import Bvh, RasterizeOptions, TraceOptions
from ..differentiable import Gradients, PassOutput, Planes, SetTensors, draw
from ..gaussians import GaussianSet
from ..rendering import Rendering
from ..threads import workers
from . import native

if TYPE_CHECKING:
    from . import _native

target: str | None = None  # the kind of CPU that the extension was compiled for, such as x86-64-v3
_import_error: ImportError | None = None
try:
    target, _native = native.load()
except ImportError as error:
    _import_error = error


def why_unavailable() -> str | None:
    if _import_error is not None:
        return f"its extension did not load ({_import_error})"
    return None


def rasterize(gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering:
    flat = draw(RasterPass(gaussians, camera, options), gaussians, color_statistics=options.color_statistics)
    return flat.map(lambda plane: plane.unflatten(0, (camera.height, camera.width)))


def build_bvh(gaussians: GaussianSet) -> Bvh:
    return Bvh("cpu", len(gaussians), _native.Bvh(tuple(SetTensors.of(gaussians)), workers()))


def trace(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> Rendering:
    return draw(_TracePass(gaussians, origins, directions, bvh, options), gaussians, origins, directions)


def _zero_gradients(tensors: SetTensors) -> tuple[SetTensors, Tensor]:
    return SetTensors(*(torch.zeros_like(tensor) for tensor in tensors)), torch.zeros_like(tensors.means)


class RasterPass:
    def __init__(self, gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> None:
        self.tensors = SetTensors.of(gaussians)
        self.pixels = camera.width * camera.height
        self.removals = options.removals
        self.native = _native.raster_pass(
            tuple(self.tensors),
            camera.world_to_camera.contiguous(),
            camera.intrinsics.contiguous(),
            camera.pixel_to_direction().contiguous(),
            camera.center.contiguous(),
            camera.width,
            camera.height,
            options.near,
            options.low_pass,
            options.low_pass_statistics,
            options.background,
            options.transmittance_min,
            workers(),
        )

    def forward(self, keep: bool) -> PassOutput:
        planes = Planes.empty(self.tensors.means, self.pixels, self.tensors.extras.shape[1])
        hits = torch.empty(self.pixels, dtype=torch.int32)
        weights = torch.empty_like(self.tensors.opacities)
        self.native.forward(tuple(planes), hits, weights)
        return PassOutput(planes, hits, weights)

    def backward(self, planes: Planes, gradients: tuple[Tensor | None, ...]) -> Gradients:
        result, position_gradients = _zero_gradients(self.tensors)
        self.native.backward(tuple(planes), gradients, (*result, position_gradients), self.removals)
        return Gradients(result, position_gradients)

    def list_lengths(self) -> Tensor:
        """[tiles] int32, primitives in the list of each tile of 16×16 pixels, row by row, as `forward` drew them."""
        return torch.tensor(self.native.list_lengths(), dtype=torch.int32)


class _TracePass:
    def __init__(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
    ) -> None:
        self.tensors = SetTensors.of(gaussians)
        self.origins, self.directions = origins.detach().contiguous(), directions.detach().contiguous()
        self.options = options  # `native` borrows its thresholds
        threads = workers()
        if bvh is not None and bvh.backend != "cpu":
            raise ValueError(
                f"the BVH was built by backend {bvh.backend!r}, this is 'cpu': build it with backend='cpu'"
            )
        handle = _native.Bvh(tuple(self.tensors), threads) if bvh is None else bvh.handle
        self.native = _native.TracePass(
            handle,
            tuple(self.tensors),
            self.origins,
            self.directions,
            options.transmittance_min,
            options.background,
            options.t_min,
            options.sh_along_ray,
            threads,
        )

    def forward(self, keep: bool) -> PassOutput:
        rays = self.origins.shape[0]
        planes = Planes.empty(self.tensors.means, rays, self.tensors.extras.shape[1])
        hits = torch.empty(rays, dtype=torch.int32)
        weights = torch.empty_like(self.tensors.opacities)
        self.native.forward(tuple(planes), hits, weights, keep)
        return PassOutput(planes, hits, weights)

    def backward(self, planes: Planes, gradients: tuple[Tensor | None, ...]) -> Gradients:
        result, position_gradients = _zero_gradients(self.tensors)
        origins, directions = torch.empty_like(self.origins), torch.empty_like(self.directions)
        filled = (*result, position_gradients)
        self.native.backward(tuple(planes), gradients, filled, origins, directions, self.options.removals)
        return Gradients(result, position_gradients, origins, directions)
