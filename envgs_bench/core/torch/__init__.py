"""The oracle: rasterize and trace in plain PyTorch, differentiated by autograd, in any floating-point dtype.

It is written to be read. Every pixel or ray is tested against every primitive; the few pairs that are blended are then
computed once more with gradients. What the faster backends draw is what this one says, see docs/reference/core.md.
"""

from __future__ import annotations

from torch import Tensor

from ..camera import Camera
from ..contract import Bvh, RasterizeOptions, TraceOptions
from ..gaussians import GaussianSet
from ..rendering import Rendering
from .blending import blend_hits
from .gaussians_3d import RasterizedGaussians3D
from .intersections import Intersector
from .search import all_blended_hits
from .surfels import RasterizedSurfels, TracedSurfels

__all__ = ["build_bvh", "rasterize", "trace", "why_unavailable"]


def why_unavailable() -> str | None:
    return None


def rasterize(gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering:
    kind = RasterizedSurfels if gaussians.is_surfels else RasterizedGaussians3D
    intersector: Intersector = kind(gaussians, camera, near=options.near, low_pass=options.low_pass)
    hits = all_blended_hits(intersector, options.transmittance_min)
    return blend_hits(
        intersector,
        hits,
        options.background,
        options.low_pass_statistics,
        options.color_statistics,
        options.removals,
    )


def trace(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> Rendering:
    if bvh is not None and bvh.backend != "torch":
        raise ValueError(
            f"the BVH was built by backend {bvh.backend!r}, this is 'torch': build it with backend='torch'"
        )
    intersector = TracedSurfels(gaussians, origins, directions, options.t_min, options.sh_along_ray)
    hits = all_blended_hits(intersector, options.transmittance_min)
    return blend_hits(intersector, hits, options.background, removals=options.removals)


def build_bvh(gaussians: GaussianSet) -> Bvh:
    """Nothing: the oracle tests every primitive."""
    return Bvh("torch", len(gaussians), None)
