"""3D Gaussians, projected by the local affine approximation (EWA splatting, 3D Gaussian Splatting)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera
from ..gaussians import GaussianSet
from .colors import seen_color
from .intersections import Intersections, Intersector
from .pixels import Pixels
from .rotation import rotation_matrices

LOW_PASS_VARIANCE = 0.3  # px², added to a projected covariance
FRUSTUM_MARGIN = 0.3  # share of the half width (height): how far outside the image the projection is linearized


class RasterizedGaussians3D(Intersector):
    """3D Gaussians as a camera sees them, in the order of their centers' depth."""

    def __init__(self, gaussians: GaussianSet, camera: Camera, near: float, low_pass: bool) -> None:
        self.gaussians, self.near, self.low_pass = gaussians, near, low_pass
        self.pixels = Pixels(camera, gaussians.means.dtype)
        self.shape = (camera.height, camera.width)
        frames = rotation_matrices(gaussians.quaternions)
        shortest = gaussians.scales.argmin(dim=1)
        self.axes = frames.gather(2, shortest[:, None, None].expand(-1, 3, 1))[..., 0]
        self.factors = frames * gaussians.scales[:, None, :]
        offsets = gaussians.means - self.pixels.center
        self.color_of = seen_color(gaussians.sh, offsets)
        self.facing = torch.where((self.axes * offsets).sum(-1) > 0, -1, 1).to(offsets)

    def intersect(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Intersections:
        depths = self.pixels.depths(means)
        in_front = (depths >= self.near) & (depths > 0)
        jacobian = self.jacobian(means, in_front) @ self.pixels.camera.world_to_camera[:3, :3]
        m0, m1 = (jacobian @ self.factors[primitives]).unbind(-2)
        dilation = LOW_PASS_VARIANCE if self.low_pass else 0.0
        # V = [m0 m1]ᵀ·[m0 m1] + d·I. A needle's is all but singular: xx·yy − xy² would leave nothing of its width, so
        # that what y varies where x is known, yy − xy²/xx, is found by a cross product.
        xx = (m0 * m0).sum(-1) + dilation
        known = torch.where(xx > 0, xx, 1)
        slope = (m0 * m1).sum(-1) / known
        across = torch.linalg.cross(m0, m1, dim=-1)
        left = ((across * across).sum(-1) + dilation * (m1 * m1).sum(-1)) / known + dilation
        valid = in_front & (xx > 0) & (left > 0)
        x, y = self.pixels.offsets(rays, means, in_front).unbind(-1)
        rho = x * x / known + (y - slope * x).square() / torch.where(valid, left, 1)
        depths = depths.expand_as(rho)
        return Intersections(
            depths, rho, order=depths, facing=self.facing[primitives].expand_as(rho), valid=valid.expand_as(rho)
        )

    def jacobian(self, means: Tensor, in_front: Tensor) -> Tensor:
        """d(pixel position) / d(camera-frame position) at the centers [..., 3], [..., 2, 3].

        The position where it is taken is clamped to the image and a margin: further out the approximation explodes.
        """
        x, y, z = self.pixels.in_camera(means).unbind(-1)
        z = torch.where(in_front, z, 1)
        camera = self.pixels.camera
        k = camera.intrinsics
        slope_x = clamped_slope(x / z, k[0, 0], k[0, 2], camera.width)
        slope_y = clamped_slope(y / z, k[1, 1], k[1, 2], camera.height)
        zero, inverse = torch.zeros_like(z), 1 / z
        of_slopes = torch.stack([inverse, zero, -slope_x * inverse, zero, inverse, -slope_y * inverse], dim=-1)
        by_position: Tensor = of_slopes.unflatten(-1, (2, 3))
        return k[:2, :2] @ by_position

    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        return self.color_of[primitives]


def clamped_slope(slope: Tensor, focal: Tensor, center: Tensor, size: int) -> Tensor:
    """x/z (or y/z) clamped to the image's extent and FRUSTUM_MARGIN of its half size on either side."""
    margin = FRUSTUM_MARGIN * size / 2
    return slope.clamp(float(-(center + margin) / focal), float((size - center + margin) / focal))
