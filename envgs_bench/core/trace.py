"""trace() and trace_color(): surfels along arbitrary rays."""

from __future__ import annotations

import torch
from torch import Tensor

from .backends import load_backend
from .contract import Backend, Bvh, ColorKernels, TraceOptions
from .gaussians import GaussianSet
from .rasterize import check_not_negative, checked_background, refuse_gradients
from .removals import removals_wanted
from .rendering import Rendering

SH_DIRECTIONS = ("center", "ray")


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
    transmittance_min: Tensor | float = 1e-4,  # [...] or for all
    sh_direction: str = "center",
    bvh: Bvh | None = None,
    backend: str = "auto",
) -> Rendering:
    """Blend the surfels along each ray in the order of their hits (EnvGS paper, Sec. 4.2, App. D).

    Differentiable in every field of the set and in the rays' origins and directions. A ray is o + t·d, t ≥ 0, and d
    need not have unit length: distances are in units of |d|. Where d is zero, nothing is hit. Hits at equal t are
    blended in the order of their index. Tracing `camera.rays()` with t_min = near gives what
    `rasterize(..., low_pass=False)` draws wherever hits and centers sort alike.

    Args:
        gaussians: N surfels, world frame.
        origins, directions: rays, world frame, any leading shape.
        background: [3] color behind everything, in [0, 1]; black where None. Receives no gradient.
        t_min: hits at smaller t are not drawn, 0 or more.
        transmittance_min: a ray ends with the hit that takes its transmittance below this, of each ray or of all. A
            ray that counts little may end sooner. One of which this is above 1 or NaN draws nothing. Receives no
            gradient.
        sh_direction: where spherical harmonics are evaluated: "center", from the ray's origin toward each surfel's
            center, as an image of a camera there has them; or "ray", along the ray, whose direction then gets their
            gradient, and no center does (EnvGS's released tracer).
        bvh: from `build_bvh` over the very same values; built here where None.
        backend: "auto" (by device), "cpu", "cuda", "torch" or "embree".

    Returns:
        Rendering with the rays' leading shape. `statistics` covers this call; position gradients after backward().

    Raises:
        ValueError: rays of a wrong shape, dtype or device, 3D Gaussians, a negative `t_min`, a foreign BVH, an unknown
            backend or `sh_direction`.
        RuntimeError: the backend does not work on this machine.
    """
    module, options = _checked(
        gaussians, origins, directions, background, t_min, transmittance_min, sh_direction, bvh, backend
    )
    flat = module.trace(gaussians, origins.reshape(-1, 3), directions.reshape(-1, 3), bvh, options)
    return _reshaped(flat, origins.shape[:-1])


def trace_color(
    gaussians: GaussianSet,
    origins: Tensor,  # [..., 3]
    directions: Tensor,  # [..., 3]
    *,
    background: Tensor | None = None,
    t_min: float = 0.0,
    transmittance_min: Tensor | float = 1e-4,  # [...] or for all
    sh_direction: str = "center",
    bvh: Bvh | None = None,
    backend: str = "auto",
) -> tuple[Tensor, Tensor]:
    """`trace`'s color [..., 3] and alpha [...] alone: for pictures that are looked at or scored, not learned from.

    With the arguments of `trace`, and no gradients. A GPU draws it faster, from spherical harmonics in half precision:
    a coefficient is off by 1/2048 of itself at most, and those beyond ±65,504 become that. Where coefficients are below
    0.7, that changes colors by 3e-5 on average and 2.3e-4 at most (tests' scenes against float64; one step of 8 bits
    is 4e-3). Alpha is `trace`'s, to rounding.

    Raises:
        ValueError: as `trace`; or gradients are recorded and an argument requires one.
        RuntimeError: the backend does not work on this machine.
    """
    module, options = _checked(
        gaussians, origins, directions, background, t_min, transmittance_min, sh_direction, bvh, backend
    )
    refuse_gradients("trace", gaussians, origins, directions)
    shape, rays = origins.shape[:-1], (origins.reshape(-1, 3), directions.reshape(-1, 3))
    if isinstance(module, ColorKernels):
        color, alpha = module.trace_color(gaussians, *rays, bvh, options)
    else:
        drawn = module.trace(gaussians, *rays, bvh, options)
        color, alpha = drawn.color, drawn.alpha
    return color.reshape(*shape, 3), alpha.reshape(shape)


def _checked(
    gaussians: GaussianSet,
    origins: Tensor,
    directions: Tensor,
    background: Tensor | None,
    t_min: float,
    transmittance_min: Tensor | float,
    sh_direction: str,
    bvh: Bvh | None,
    backend: str,
) -> tuple[Backend, TraceOptions]:
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
    check_not_negative("t_min", t_min)
    if sh_direction not in SH_DIRECTIONS:
        raise ValueError(f"sh_direction is {sh_direction!r}, expected {' or '.join(SH_DIRECTIONS)}")
    module = load_backend(backend, gaussians.device, gaussians.means.dtype)
    if bvh is not None and bvh.primitives != len(gaussians):
        raise ValueError(
            f"the BVH was built over {bvh.primitives} primitives, the set has {len(gaussians)}: rebuild it"
        )
    background = checked_background(background, gaussians)
    ends = _of_each_ray(transmittance_min, origins)
    return module, TraceOptions(background, t_min, ends, sh_direction == "ray", removals_wanted())


def _of_each_ray(transmittance_min: Tensor | float, origins: Tensor) -> Tensor:
    """[R] for rays whose origins are [..., 3]."""
    shape = origins.shape[:-1]
    if not isinstance(transmittance_min, Tensor):
        return origins.new_full((shape.numel(),), transmittance_min)
    given = transmittance_min.detach()
    if given.shape != shape or (given.dtype, given.device) != (origins.dtype, origins.device):
        raise ValueError(
            f"transmittance_min is {given.dtype} {tuple(given.shape)} on {given.device}, expected a number, or "
            f"{origins.dtype} {tuple(shape)} on {origins.device}: one for each ray"
        )
    return given.reshape(-1).contiguous()


def _check_surfels(gaussians: GaussianSet) -> None:
    if not gaussians.is_surfels:
        raise ValueError("trace takes surfels (scales [N, 2]); 3D Gaussians (scales [N, 3]) can only be rasterized")


def _reshaped(rendering: Rendering, shape: torch.Size) -> Rendering:
    def unflatten(values: Tensor) -> Tensor:
        return values.reshape((*shape, *values.shape[1:]))

    return rendering.map(unflatten)
