"""The CUDA backend: CUDA C++ compiled at first use, on torch's current stream. See docs/explanation/core.md."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..camera import Camera
from ..contract import Bvh, RasterizeOptions, TraceOptions
from ..differentiable import SetTensors, draw
from ..gaussians import GaussianSet
from ..rendering import Rendering
from .adam import adam_step
from .bvh import SurfelBvh
from .compiler import why_unavailable
from .normals import depth_normals
from .raster_pass import RasterPass
from .reflect import reflect
from .ssim import ssim_map
from .trace_pass import TracePass

__all__ = [
    "adam_step",
    "build_bvh",
    "depth_normals",
    "rasterize",
    "rasterize_color",
    "reflect",
    "ssim_map",
    "trace",
    "trace_color",
    "why_unavailable",
]


def rasterize(gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering:
    with torch.cuda.device(gaussians.device):
        flat = draw(RasterPass(gaussians, camera, options), gaussians, color_statistics=options.color_statistics)
    return flat.map(lambda plane: plane.unflatten(0, (camera.height, camera.width)))


def rasterize_color(gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> tuple[Tensor, Tensor]:
    with torch.cuda.device(gaussians.device):
        color, alpha = RasterPass(replace(gaussians, extras=None), camera, options, color_alone=True).color()
    return color.unflatten(0, (camera.height, camera.width)), alpha.unflatten(0, (camera.height, camera.width))


def build_bvh(gaussians: GaussianSet) -> Bvh:
    with torch.cuda.device(gaussians.device):
        return Bvh("cuda", len(gaussians), SurfelBvh(SetTensors.of(gaussians)))


def trace(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> Rendering:
    with torch.cuda.device(gaussians.device):
        tree = _tree(gaussians, bvh)
        return draw(TracePass(gaussians, origins, directions, tree, options), gaussians, origins, directions)


def trace_color(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> tuple[Tensor, Tensor]:
    with torch.cuda.device(gaussians.device):
        tree = _tree(gaussians, bvh)
        return TracePass(replace(gaussians, extras=None), origins, directions, tree, options, color_alone=True).color()


def _tree(gaussians: GaussianSet, bvh: Bvh | None) -> SurfelBvh:
    if bvh is None:
        return SurfelBvh(SetTensors.of(gaussians))
    if bvh.backend != "cuda":
        raise ValueError(f"the BVH was built by backend {bvh.backend!r}, this is 'cuda': build it with backend='cuda'")
    tree: SurfelBvh = bvh.handle
    return tree
