"""The rays that a drawn image reflects, in one kernel and without waiting to learn how many there are."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..camera import Camera
from ..rendering import Rendering
from .launch import Kernels, blocks_for, kernels
from .raster_pass import make_camera


def reflect(
    image: Rendering, camera: Camera, offset: float, alpha_min: float, beta_min: Tensor | float
) -> tuple[Tensor, Tensor, Tensor]:
    planes = (image.alpha, image.depth, image.normal.movedim(2, 0), image.extras[..., 0])
    with torch.cuda.device(image.alpha.device):
        rays: tuple[Tensor, Tensor, Tensor] = _Reflect.apply(*planes, camera, float(offset), float(alpha_min), beta_min)
        return rays


class _Reflect(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, alpha: Tensor, depth: Tensor, normal: Tensor, beta: Tensor, camera: Camera, offset: float,
        alpha_min: float, beta_min: Tensor | float,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        height, width = alpha.shape
        launch = _kernels(alpha)
        view = make_camera(launch, camera)
        alpha, depth, normal, beta = (plane.contiguous() for plane in (alpha, depth, normal, beta))
        origins, directions, weights = (alpha.new_empty(height, width, *shape) for shape in ((3,), (3,), ()))
        on_device = isinstance(beta_min, Tensor)
        launch("reflect_pixels", blocks_for(alpha.numel(), 256), 256, view, alpha, depth, normal, beta, offset,
               alpha_min, 0.0 if on_device else float(beta_min), beta_min if on_device else None, origins,
               directions, weights)  # fmt: skip
        ctx.save_for_backward(view, normal, directions)
        ctx.offset = offset
        return origins, directions, weights

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        view, normal, directions = ctx.saved_tensors
        g_depth, g_beta = (normal.new_empty(normal.shape[1:]) for _ in range(2))
        g_normal = torch.empty_like(normal)
        with torch.cuda.device(normal.device):
            _kernels(normal)("differentiate_reflection", blocks_for(g_depth.numel(), 256), 256, view, normal,
                             directions, ctx.offset, *(g.contiguous() for g in gradients), g_depth, g_normal,
                             g_beta)  # fmt: skip
        return None, g_depth, g_normal, g_beta, None, None, None, None


def _kernels(tensor: Tensor) -> Kernels:
    return kernels(("camera.cu", "reflect.cu"), tensor.device)
