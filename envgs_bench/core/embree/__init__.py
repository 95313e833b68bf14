"""The independent oracle of `trace`: Embree finds which surfels a ray intersects, the torch oracle blends them."""

from __future__ import annotations

from torch import Tensor

from ..contract import Bvh, TraceOptions
from ..gaussians import GaussianSet
from ..rendering import Rendering
from ..torch.blending import blend_hits
from ..torch.search import blended_hits
from ..torch.surfels import TracedSurfels

__all__ = ["build_bvh", "trace", "why_unavailable"]


def why_unavailable() -> str | None:
    try:
        import embreex.rtcore_scene  # noqa: F401
    except ImportError as error:
        return f"embreex cannot be imported ({error}): pip install embreex"
    return None


def trace(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
) -> Rendering:
    from .search import candidate_pairs

    if bvh is not None and bvh.backend != "embree":
        raise ValueError(f"the BVH was built by backend {bvh.backend!r}, this is 'embree': build it with its backend")
    rays, primitives = candidate_pairs(gaussians, origins, directions, options.t_min)
    intersector = TracedSurfels(gaussians, origins, directions, options.t_min, options.sh_along_ray)
    hits = blended_hits(intersector, rays, primitives, options.transmittance_min)
    return blend_hits(intersector, hits, options.background, removals=options.removals)


def build_bvh(gaussians: GaussianSet) -> Bvh:
    """Nothing to keep: the search builds Embree's scenes as it goes."""
    return Bvh("embree", len(gaussians), None)
