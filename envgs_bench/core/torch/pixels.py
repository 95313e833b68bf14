"""Pixels: a camera's rays and projection, in the dtype of the primitives."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera


class Pixels:
    """The pixels of a camera, row by row."""

    def __init__(self, camera: Camera, dtype: torch.dtype) -> None:
        self.camera = camera.to(dtype)
        self.center = self.camera.center
        self.directions = self.camera.rays()[1].reshape(-1, 3)

    def positions(self, rays: Tensor) -> Tensor:
        """Centers (x, y) of the pixels given by index, [..., 2]."""
        columns, rows = rays % self.camera.width, rays // self.camera.width
        return torch.stack([columns, rows], dim=-1) + torch.tensor(0.5).to(self.center)

    def in_camera(self, points: Tensor) -> Tensor:
        """World points [..., 3] in the camera's frame."""
        return points @ self.camera.world_to_camera[:3, :3].T + self.camera.world_to_camera[:3, 3]

    def depths(self, points: Tensor) -> Tensor:
        return self.in_camera(points)[..., 2]

    def offsets(self, rays: Tensor, points: Tensor, in_front: Tensor) -> Tensor:
        """Pixel centers minus the projections of world points, [..., 2]; meaningless where a point is not in front."""
        in_camera = self.in_camera(points)
        # A point in the camera's plane has no projection: keep its gradient finite.
        z = torch.where(in_front, in_camera[..., 2], 1)
        homogeneous = torch.stack([in_camera[..., 0] / z, in_camera[..., 1] / z, torch.ones_like(z)], dim=-1)
        return self.positions(rays) - homogeneous @ self.camera.intrinsics[:2].T

    def squared_distance(self, rays: Tensor, points: Tensor, in_front: Tensor) -> Tensor:
        """Squared distance in pixels of pixel centers from the projections of world points."""
        offsets = self.offsets(rays, points, in_front)
        return (offsets * offsets).sum(-1)
