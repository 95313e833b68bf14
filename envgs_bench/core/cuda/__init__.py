"""The CUDA backend: CUDA C++ compiled at first use, on torch's current stream. See docs/performance_gpu.md."""

from __future__ import annotations

import torch
from torch import Tensor

from ..backends import RasterizeOptions, TraceOptions
from ..camera import Camera
from ..differentiable import SetTensors, draw
from ..gaussians import GaussianSet
from ..rendering import Rendering
from ..trace import Bvh
from .adam import adam_step
from .bvh import SurfelBvh
from .compiler import why_unavailable
from .normals import depth_normals
from .raster_pass import RasterPass
from .reflect import reflect
from .ssim import ssim_map
from .trace_pass import TracePass

__all__ = ["adam_step", "build_bvh", "depth_normals", "rasterize", "reflect", "ssim_map", "trace", "why_unavailable"]


def rasterize(gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering:
    with torch.cuda.device(gaussians.device):
        flat = draw(RasterPass(gaussians, camera, options), gaussians)
    return flat.map(lambda plane: plane.unflatten(0, (camera.height, camera.width)))


def build_bvh(gaussians: GaussianSet) -> Bvh:
    with torch.cuda.device(gaussians.device):
        return Bvh("cuda", len(gaussians), SurfelBvh(SetTensors.of(gaussians)))


def trace(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> Rendering:
    if bvh is not None and bvh.backend != "cuda":
        raise ValueError(f"the BVH was built by backend {bvh.backend!r}, this is 'cuda': build it with backend='cuda'")
    with torch.cuda.device(gaussians.device):
        tree = SurfelBvh(SetTensors.of(gaussians)) if bvh is None else bvh.handle
        return draw(TracePass(gaussians, origins, directions, tree, options), gaussians, origins, directions)
