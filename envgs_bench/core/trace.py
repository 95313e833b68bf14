"""trace(): surfels along arbitrary rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .backends import TraceOptions, load_backend
from .gaussians import GaussianSet
from .rasterize import checked_background
from .rendering import Rendering

SH_DIRECTIONS = ("center", "ray")


@dataclass(frozen=True)
class Bvh:
    """A bounding volume hierarchy over one state of one set: build it again whenever the set changes."""

    backend: str
    primitives: int
    handle: Any


def build_bvh(gaussians: GaussianSet, *, backend: str = "auto") -> Bvh:
    """The acceleration structure that `trace` would build for this set, to be shared between several calls."""
    _check_surfels(gaussians)
    return load_backend(backend, gaussians.device, gaussians.means.dtype).build_bvh(gaussians.map(Tensor.detach))


def trace(
    gaussians: GaussianSet,
    origins: Tensor,  # [..., 3]
    directions: Tensor,  # [..., 3]
    *,
    background: Tensor | None = None,
    t_min: float = 0.0,
    transmittance_min: float = 1e-4,
    sh_direction: str = "center",
    bvh: Bvh | None = None,
    backend: str = "auto",
) -> Rendering:
    """Blend the surfels along each ray in the order of their hits (EnvGS paper, Sec. 4.2, App. D).

    Differentiable in every field of the set and in the rays' origins and directions. A ray is o + t·d, t > 0, and d
    need not have unit length: distances are in units of |d|. Where d is zero, nothing is hit. Hits at equal t are
    blended in the order of their index. Tracing `camera.rays()` with t_min = near gives what
    `rasterize(..., low_pass=False)` draws wherever hits and centers sort alike.

    Args:
        gaussians: N surfels, world frame.
        origins, directions: rays, world frame, any leading shape.
        background: [3] color behind everything, in [0, 1]; black where None. Receives no gradient.
        t_min: hits at smaller t are not drawn.
        transmittance_min: a ray ends with the hit that takes its transmittance below this.
        sh_direction: where spherical harmonics are evaluated: "center", from the ray's origin toward each surfel's
            center, as an image of a camera there has them; or "ray", along the ray, whose direction then gets their
            gradient, and no center does (EnvGS's released tracer).
        bvh: from `build_bvh` over the very same values; built here where None.
        backend: "auto" (by device), "cpu", "cuda", "torch" or "embree".

    Returns:
        Rendering with the rays' leading shape. `statistics` covers this call; position gradients after backward().

    Raises:
        ValueError: rays of a wrong shape, dtype or device, 3D Gaussians, a foreign BVH, an unknown backend or
            `sh_direction`.
        RuntimeError: the backend does not work on this machine.
    """
    _check_surfels(gaussians)
    if origins.shape != directions.shape or origins.shape[-1:] != (3,):
        raise ValueError(
            f"origins {tuple(origins.shape)} and directions {tuple(directions.shape)} must share a shape [..., 3]"
        )
    for name, rays in (("origins", origins), ("directions", directions)):
        if rays.device != gaussians.device or rays.dtype != gaussians.means.dtype:
            raise ValueError(
                f"{name} are {rays.dtype} on {rays.device}, gaussians {gaussians.means.dtype} on {gaussians.device}"
            )
    if sh_direction not in SH_DIRECTIONS:
        raise ValueError(f"sh_direction is {sh_direction!r}, expected {' or '.join(SH_DIRECTIONS)}")
    module = load_backend(backend, gaussians.device, gaussians.means.dtype)
    if bvh is not None and bvh.primitives != len(gaussians):
        raise ValueError(
            f"the BVH was built over {bvh.primitives} primitives, the set has {len(gaussians)}: rebuild it"
        )
    options = TraceOptions(checked_background(background, gaussians), t_min, transmittance_min, sh_direction == "ray")
    flat = module.trace(gaussians, origins.reshape(-1, 3), directions.reshape(-1, 3), bvh, options)
    return _reshaped(flat, origins.shape[:-1])


def _check_surfels(gaussians: GaussianSet) -> None:
    if not gaussians.is_surfels:
        raise ValueError("trace takes surfels (scales [N, 2]); 3D Gaussians (scales [N, 3]) can only be rasterized")


def _reshaped(rendering: Rendering, shape: torch.Size) -> Rendering:
    def unflatten(values: Tensor) -> Tensor:
        return values.reshape((*shape, *values.shape[1:]))

    return rendering.map(unflatten)
