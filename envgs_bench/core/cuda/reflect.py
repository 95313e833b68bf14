"""The rays that a drawn image reflects, in one kernel and without waiting to learn how many there are."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera
from ..rendering import Rendering
from .launch import blocks_for, kernels
from .raster_pass import make_view


def reflect(
    image: Rendering, camera: Camera, offset: float, alpha_min: float, beta_min: Tensor | float
) -> tuple[Tensor, Tensor, Tensor]:
    height, width = image.alpha.shape
    pixels = height * width
    with torch.cuda.device(image.alpha.device):
        launch = kernels(("view.cu", "reflect.cu"), image.alpha.device)
        view = make_view(launch, camera, near=0.0, low_pass=False)
        planes = (image.alpha, image.depth, image.normal.movedim(2, 0), image.extras[..., 0])
        alpha, depth, normal, beta = (plane.detach().contiguous() for plane in planes)
        origins, directions, weights = (alpha.new_empty(height, width, *shape) for shape in ((3,), (3,), ()))
        on_device = isinstance(beta_min, Tensor)
        launch("reflect_pixels", blocks_for(pixels, 256), 256, view, alpha, depth, normal, beta, float(offset),
               float(alpha_min), 0.0 if on_device else float(beta_min), beta_min if on_device else None, origins,
               directions, weights)  # fmt: skip
    return origins, directions, weights
