"""Camera: a pinhole view, OpenCV axes (x right, y down, z forward), pixel centers at +0.5."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

ROTATION_ERROR = 1e-5  # of R·Rᵀ, 0.01 pixels at a focal length of 1,000: rays take Rᵀ for the inverse, projections R


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with full intrinsics.

    A world point p is seen at pixel (x, y) = (h₀/h₂, h₁/h₂) with h = K·(R·p + t), where [R|t] are the first three rows
    of `world_to_camera`; the center of the pixel in column c and row r is (c + 0.5, r + 0.5).

    Values are checked where a camera is made, which waits for a GPU that holds them; not again in what `to`, `resized`
    and `clone` return.

    Raises:
        ValueError: a shape is wrong, a value not finite, the size not positive, the rotation off by more
            than 1e-5, or K not upper triangular with a last row of (0, 0, 1).
    """

    world_to_camera: Tensor
    """[4, 4]"""
    intrinsics: Tensor
    """[3, 3], pixels"""
    width: int
    height: int

    def __post_init__(self) -> None:
        self._check_shapes()
        pose, k = self.world_to_camera.detach().double().cpu(), self.intrinsics.detach().double().cpu()
        if not (torch.isfinite(pose).all() and torch.isfinite(k).all()):
            raise ValueError("Camera has a pose or intrinsics that are not finite")
        rotation = pose[:3, :3]
        error = float((rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max())
        if error > ROTATION_ERROR:
            raise ValueError(
                f"Camera.world_to_camera[:3, :3] is not a rotation: R·Rᵀ differs from the unit matrix by {error:.1e}, "
                f"expected at most {ROTATION_ERROR:.0e}; give the pose more digits, or take the nearest rotation"
            )
        if torch.linalg.det(rotation) < 0:
            raise ValueError("Camera.world_to_camera[:3, :3] is not a rotation but a mirror (its determinant is −1)")
        if k[2].tolist() != [0.0, 0.0, 1.0] or k[1, 0] != 0 or k[0, 0] <= 0 or k[1, 1] <= 0:
            raise ValueError(
                f"Camera.intrinsics is {k.tolist()}, expected positive focal lengths, 0 below them "
                "and a last row of (0, 0, 1)"
            )

    def _check_shapes(self) -> None:
        if tuple(self.world_to_camera.shape) != (4, 4):
            raise ValueError(f"Camera.world_to_camera has shape {tuple(self.world_to_camera.shape)}, expected (4, 4)")
        if tuple(self.intrinsics.shape) != (3, 3):
            raise ValueError(f"Camera.intrinsics has shape {tuple(self.intrinsics.shape)}, expected (3, 3)")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Camera is {self.width}×{self.height} pixels, expected at least 1×1")

    def _changed(self, **fields: Any) -> Camera:
        """A copy with other values that follow from these, which are not checked: a GPU is not waited for."""
        camera = copy(self)
        for name, value in fields.items():
            object.__setattr__(camera, name, value)
        camera._check_shapes()
        return camera

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
        return self._changed(intrinsics=intrinsics, width=width, height=height)

    def to(self, target: torch.device | torch.dtype | str) -> Camera:
        return self._changed(world_to_camera=self.world_to_camera.to(target), intrinsics=self.intrinsics.to(target))

    def clone(self) -> Camera:
        """The camera with tensors of its own."""
        return self._changed(world_to_camera=self.world_to_camera.clone(), intrinsics=self.intrinsics.clone())

    def check_like(self, tensor: Tensor, name: str) -> None:
        """Raise ValueError where kernels that read `tensor` would read the camera as something else."""
        for field in (self.world_to_camera, self.intrinsics):
            if (field.dtype, field.device) != (tensor.dtype, tensor.device):
                raise ValueError(
                    f"camera is {field.dtype} on {field.device}, {name} {tensor.dtype} on {tensor.device}: "
                    "convert one with .to()"
                )
