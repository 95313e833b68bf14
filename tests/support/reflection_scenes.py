"""A small camera, and what a planar mirror shows it."""

import math

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Statistics

WIDTH, HEIGHT = 20, 16


def make_camera() -> Camera:
    angle = 0.3
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor(
        [[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]]
    )
    pose[:3, 3] = torch.tensor([0.2, 0.1, 0.5])
    return Camera(pose, torch.tensor([[18.0, 0, 9], [0, 17, 8.5], [0, 0, 1]]), WIDTH, HEIGHT)


def make_rendering(depth: Tensor, normal: Tensor, alpha: Tensor, beta: Tensor) -> Rendering:
    return Rendering(
        color=torch.full((HEIGHT, WIDTH, 3), 0.25),
        alpha=alpha,
        depth=depth,
        normal=normal,
        extras=beta[..., None],
        hits=torch.ones(HEIGHT, WIDTH, dtype=torch.int32),
        statistics=Statistics(torch.zeros(0)),
    )


def mirror(camera: Camera, normal: Tensor, distance: float) -> Rendering:
    """The plane x·normal = distance as seen by the camera; blended normals are half as long as unit ones."""
    origins, directions = camera.rays()
    depth = (distance - origins @ normal) / (directions @ normal)
    full = torch.ones(HEIGHT, WIDTH)
    return make_rendering(depth, 0.5 * normal.expand(HEIGHT, WIDTH, 3), full, 0.5 * full)
