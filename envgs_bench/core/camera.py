"""Camera: a pinhole view, OpenCV axes (x right, y down, z forward), pixel centers at +0.5."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with full intrinsics.

    A world point p is seen at pixel (x, y) = (h₀/h₂, h₁/h₂) with h = K·(R·p + t), where [R|t] are the first three rows
    of `world_to_camera`; the center of the pixel in column c and row r is (c + 0.5, r + 0.5).

    Raises:
        ValueError: a shape is wrong, a value not finite, the size not positive, the rotation not a rotation,
            or the last row of K not (0, 0, 1).
    """

    world_to_camera: Tensor
    """[4, 4]"""
    intrinsics: Tensor
    """[3, 3], pixels"""
    width: int
    height: int

    def __post_init__(self) -> None:
        if tuple(self.world_to_camera.shape) != (4, 4):
            raise ValueError(f"Camera.world_to_camera has shape {tuple(self.world_to_camera.shape)}, expected (4, 4)")
        if tuple(self.intrinsics.shape) != (3, 3):
            raise ValueError(f"Camera.intrinsics has shape {tuple(self.intrinsics.shape)}, expected (3, 3)")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Camera is {self.width}×{self.height} pixels, expected at least 1×1")
        if self.world_to_camera.is_cuda:
            return  # made by .to(): already checked, and a check here would wait for the device
        pose, k = self.world_to_camera.double(), self.intrinsics.double()
        if not (torch.isfinite(pose).all() and torch.isfinite(k).all()):
            raise ValueError("Camera has a pose or intrinsics that are not finite")
        rotation = pose[:3, :3]
        if not torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-3):
            raise ValueError("Camera.world_to_camera[:3, :3] is not a rotation (its rows are not orthonormal)")
        if torch.linalg.det(rotation) < 0:
            raise ValueError("Camera.world_to_camera[:3, :3] is not a rotation but a mirror (its determinant is −1)")
        if k[2].tolist() != [0.0, 0.0, 1.0] or k[0, 0] <= 0 or k[1, 1] <= 0:
            raise ValueError("Camera.intrinsics needs positive focal lengths and a last row of (0, 0, 1)")

    @property
    def device(self) -> torch.device:
        return self.world_to_camera.device

    @property
    def center(self) -> Tensor:
        """The camera's center in the world frame, [3]."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def pixel_to_direction(self) -> Tensor:
        """The [3, 3] matrix that maps (x, y, 1) to the world-frame direction of pixel position (x, y), camera z = 1."""
        # linalg.inv would wait for the device, to check.
        inverse: Tensor = torch.linalg.inv_ex(self.intrinsics.double()).inverse
        return (self.world_to_camera[:3, :3].double().T @ inverse).to(self.intrinsics.dtype)

    def rays(self) -> tuple[Tensor, Tensor]:
        """Origins and directions of the rays through all pixel centers, each [H, W, 3], world frame.

        Directions have camera z = 1 and not unit length, so the distance t along a ray is the camera-frame depth.
        """
        dtype, device = self.intrinsics.dtype, self.device
        x = torch.arange(self.width, dtype=dtype, device=device) + 0.5
        y = torch.arange(self.height, dtype=dtype, device=device) + 0.5
        rows, columns = torch.meshgrid(y, x, indexing="ij")
        pixels = torch.stack([columns, rows, torch.ones_like(rows)], dim=-1)
        directions = pixels @ self.pixel_to_direction().T
        return self.center.expand_as(directions), directions

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Pixel positions [..., 2] and camera-frame depths [...] of world points [..., 3]."""
        in_camera = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        homogeneous = in_camera @ self.intrinsics.T
        return homogeneous[..., :2] / homogeneous[..., 2:], in_camera[..., 2]

    def resized(self, width: int, height: int) -> Camera:
        """The same view drawn at another size: intrinsics follow the actual sizes in x and in y."""
        x, y, last = self.intrinsics
        # Row by row: a tensor of scales would be copied to the device, which waits.
        intrinsics = torch.stack([x * (width / self.width), y * (height / self.height), last])
        return replace(self, intrinsics=intrinsics, width=width, height=height)

    def to(self, device: torch.device | str) -> Camera:
        return replace(self, world_to_camera=self.world_to_camera.to(device), intrinsics=self.intrinsics.to(device))
