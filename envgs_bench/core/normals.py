"""depth_normals(): the normals of the surface that a depth map shows."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from .backends import load_backend
from .camera import Camera
from .contract import ImageKernels
from .vectors import unit


def depth_normals(depth: Tensor, camera: Camera, *, backend: str = "auto") -> Tensor:
    """Normals of the surface that a depth map shows, by central differences (EnvGS paper, Eq. 8). Differentiable.

    kornia's `depth_to_normals` is another definition: Sobel's eight neighbors, with or without depth.

    Args:
        depth: [H, W] distance along each pixel's ray of `Camera.rays()`, 0 where nothing is hit.
        camera: that the map was drawn for.
        backend: "auto" (by device) or a name, as for `trace`.

    Returns:
        [H, W, 3] unit normals, world frame, facing the camera; 0 on the border and wherever one of the four neighbors
        has no depth.

    Raises:
        ValueError: the map has another size, dtype or device than the camera.
    """
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"depth {tuple(depth.shape)} is not of the camera's size {(camera.height, camera.width)}")
    camera.check_like(depth, "depth")
    module = load_backend(backend, depth.device, depth.dtype)
    if isinstance(module, ImageKernels):
        return module.depth_normals(depth, camera)
    points = depth[..., None] * camera.rays()[1]  # relative to the camera's center, which differences do not see
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    right = points[1:-1, 2:] - points[1:-1, :-2]
    hit = depth.detach() > 0
    complete = hit[2:, 1:-1] & hit[:-2, 1:-1] & hit[1:-1, 2:] & hit[1:-1, :-2]
    normals = unit(torch.linalg.cross(down, right)) * complete[..., None]
    return functional.pad(normals, (0, 0, 1, 1, 1, 1))
