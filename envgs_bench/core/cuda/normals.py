"""The normals of a depth map in one kernel each way, where the formula takes seventy."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..camera import Camera
from .launch import Kernels, blocks_for, kernels
from .raster_pass import make_camera


def depth_normals(depth: Tensor, camera: Camera) -> Tensor:
    """As `core.depth_normals`; in memory a plane a channel, as what it is compared to."""
    with torch.cuda.device(depth.device):
        planes: Tensor = _DepthNormals.apply(depth, camera)
        return planes.movedim(0, 2)


class _DepthNormals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, depth: Tensor, camera: Camera) -> Tensor:
        launch = _kernels(depth)
        view = make_camera(launch, camera)
        depth = depth.contiguous()
        normals = depth.new_empty(3, *depth.shape)
        launch("depth_normals", blocks_for(depth.numel(), 256), 256, view, depth, normals)
        ctx.save_for_backward(view, depth)
        return normals

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        view, depth = ctx.saved_tensors
        g_depth = torch.empty_like(depth)
        with torch.cuda.device(depth.device):
            _kernels(depth)("differentiate_depth_normals", blocks_for(depth.numel(), 256), 256, view, depth,
                            gradient.contiguous(), g_depth)  # fmt: skip
        return g_depth, None


def _kernels(tensor: Tensor) -> Kernels:
    return kernels(("camera.cu", "normals.cu"), tensor.device)
