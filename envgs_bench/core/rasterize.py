"""rasterize() and rasterize_color(): Gaussians to an image."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from .backends import load_backend
from .camera import Camera
from .contract import ColorKernels, RasterizeOptions, Rasterizer
from .gaussians import GaussianSet
from .removals import removals_wanted
from .rendering import Rendering


def rasterize(
    gaussians: GaussianSet,
    camera: Camera,
    *,
    background: Tensor | None = None,
    near: float = 0.2,
    low_pass: bool = True,
    low_pass_statistics: bool = True,
    color_statistics: bool = False,
    transmittance_min: float = 1e-4,
    backend: str = "auto",
) -> Rendering:
    """Draw surfels or 3D Gaussians as `camera` sees them, differentiable in every field of the set.

    Primitives are blended in the order of their centers' camera-frame depth (ties by index). Color is the primitive's
    SH toward its center. A surfel is hit where the pixel's ray intersects its plane (2D Gaussian Splatting, exact);
    a 3D Gaussian is projected with the local affine approximation (EWA, 3D Gaussian Splatting), its depth is its
    center's and its normal its shortest axis.

    Args:
        gaussians: N primitives, world frame.
        camera: the view, on the same device and of the same dtype.
        background: [3] color behind everything, in [0, 1]; black where None. Receives no gradient.
        near: hits nearer than this camera-frame depth are not drawn, world units, 0 or more.
        low_pass: anti-aliasing as in the originals: a surfel's squared distance is the smaller of its own and of a
            screen-space Gaussian of √2/2 px; a 3D Gaussian's projected covariance grows by 0.3 px².
        low_pass_statistics: whether the statistics' position gradients count the pixels in which that screen-space
            Gaussian answers for a surfel; the code of 2D Gaussian Splatting leaves them out.
        color_statistics: whether they are of the loss's part through color alone, as in 3DGS-DR's code, and not through
            alpha, depth, normal and extras; then a native backend's backward pass runs twice.
        transmittance_min: a pixel is finished by the hit that takes its transmittance below this, in [0, 1].
        backend: "auto" (by device), "cpu", "cuda" or "torch".

    Returns:
        Rendering with [H, W, …] fields. `statistics` covers this call; its position gradients appear after backward().

    Raises:
        ValueError: camera and set differ in device or dtype, a bad background, a negative `near`, a `transmittance_min`
            beyond 0 to 1, or an unknown backend.
        RuntimeError: the backend does not work on this machine.
    """
    module, options = _checked(gaussians, camera, background, near, low_pass, transmittance_min, backend)
    options = replace(
        options,
        low_pass_statistics=low_pass_statistics,
        color_statistics=color_statistics,
        removals=removals_wanted(),
    )
    return module.rasterize(gaussians, camera, options)


def rasterize_color(
    gaussians: GaussianSet,
    camera: Camera,
    *,
    background: Tensor | None = None,
    near: float = 0.2,
    low_pass: bool = True,
    transmittance_min: float = 1e-4,
    backend: str = "auto",
) -> tuple[Tensor, Tensor]:
    """`rasterize`'s color [H, W, 3] and alpha [H, W] alone: for pictures that are looked at or timed, not learned from.

    With the arguments of `rasterize`, and no gradients. A GPU draws it faster; both are `rasterize`'s, to rounding.

    Raises:
        ValueError: as `rasterize`; or gradients are recorded and the set requires one.
        RuntimeError: the backend does not work on this machine.
    """
    module, options = _checked(gaussians, camera, background, near, low_pass, transmittance_min, backend)
    refuse_gradients("rasterize", gaussians)
    if isinstance(module, ColorKernels):
        return module.rasterize_color(gaussians, camera, options)
    drawn = module.rasterize(gaussians, camera, options)
    return drawn.color, drawn.alpha


def refuse_gradients(function: str, gaussians: GaussianSet, *rays: Tensor) -> None:
    """Raise ValueError where gradients are recorded of what `<function>_color` is given, which has none."""
    if torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in (*vars(gaussians).values(), *rays)):
        raise ValueError(f"{function}_color has no gradients: call it within torch.no_grad(), or call {function}")


def _checked(
    gaussians: GaussianSet,
    camera: Camera,
    background: Tensor | None,
    near: float,
    low_pass: bool,
    transmittance_min: float,
    backend: str,
) -> tuple[Rasterizer, RasterizeOptions]:
    camera.check_like(gaussians.means, "gaussians")
    check_not_negative("near", near)
    if not 0 <= transmittance_min <= 1:
        raise ValueError(f"transmittance_min is {transmittance_min}, expected a number from 0 to 1")
    options = RasterizeOptions(checked_background(background, gaussians), near, low_pass, transmittance_min)
    module = load_backend(backend, gaussians.device, gaussians.means.dtype)
    if not isinstance(module, Rasterizer):
        raise ValueError(f"backend {backend!r} traces rays only, it cannot rasterize")
    return module, options


def check_not_negative(name: str, distance: float) -> None:
    if not distance >= 0:
        raise ValueError(
            f"{name} is {distance}, expected 0 or more: nothing is drawn behind a camera or a ray's origin"
        )


def checked_background(background: Tensor | None, gaussians: GaussianSet) -> Tensor:
    if background is None:
        return torch.zeros(3, dtype=gaussians.means.dtype, device=gaussians.device)
    if tuple(background.shape) != (3,):
        raise ValueError(f"background has shape {tuple(background.shape)}, expected (3,)")
    return background.detach().to(gaussians.means)
