"""The rays that a drawn image reflects, in one kernel and without waiting to learn how many there are."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera
from ..rendering import Rendering
from .launch import blocks_for, kernels
from .raster_pass import make_view


def reflect(
    base: Rendering, camera: Camera, *, offset: float, alpha_min: float, beta_min: Tensor | float
) -> tuple[Tensor, Tensor, Tensor]:
    """A ray a pixel: the camera's ray mirrored at the pixel's surface (EnvGS, Eqs. 3 and 4). Without gradients.

    Args:
        base: an image on the GPU; `extras[..., 0]` is β.
        camera: that it was drawn for.
        offset: how far above the surface a ray starts, world units.
        alpha_min: pixels whose alpha or blended normal is not longer than this reflect nothing,
        beta_min: nor do those whose β is not above this.

    Returns:
        Origins [H, W, 3], unit directions [H, W, 3] and β [H, W]; direction and β are zero where nothing reflects.
    """
    height, width = base.alpha.shape
    pixels = height * width
    with torch.cuda.device(base.alpha.device):
        launch = kernels(("view.cu", "reflect.cu"), base.alpha.device)
        view = make_view(launch, camera, near=0.0, low_pass=False)
        planes = (base.alpha, base.depth, base.normal.movedim(2, 0), base.extras[..., 0])
        alpha, depth, normal, beta = (plane.detach().contiguous() for plane in planes)
        origins, directions, weights = (alpha.new_empty(height, width, *shape) for shape in ((3,), (3,), ()))
        on_device = isinstance(beta_min, Tensor)
        launch("reflect_pixels", blocks_for(pixels, 256), 256, view, alpha, depth, normal, beta, float(offset),
               float(alpha_min), 0.0 if on_device else float(beta_min), beta_min if on_device else None, origins,
               directions, weights)  # fmt: skip
    return origins, directions, weights
