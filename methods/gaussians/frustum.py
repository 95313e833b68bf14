"""Which primitives a camera has in view, whether or not others hide them, as the rasterizers of 3DGS and 2DGS count."""

from __future__ import annotations

import torch
from torch import Tensor

from envgs_bench.core import Camera
from envgs_bench.core.torch.rotation import rotation_matrices

REACH = 3.0  # standard deviations
TILE = 16  # pixels
LEAST_BOX = 1e-4  # px², the square of half a surfel's box at least
LEAST_REACH = REACH * 0.5**0.5  # px, of what a surfel's low-pass draws
LOW_PASS = 0.3  # px², added to a 3D Gaussian's variance along both axes of the picture
LEAST_SPREAD = 0.1  # px⁴, of half the difference of its projection's two variances, squared
BESIDE = 1.3  # × the half picture: farther out, a 3D Gaussian is projected as if it were there


@torch.no_grad()
def in_view(means: Tensor, quaternions: Tensor, scales: Tensor, camera: Camera, near: float) -> Tensor:
    """Mask [N] of primitives that their programs call visible: it is what a mean gradient is taken over.

    The center lies beyond `near`, and a square around the projection, as large as three standard deviations, meets a
    tile of 16×16 pixels of the picture. What is far to the side counts more often than its shape says: of a surfel, the
    box is right only if all of it lies ahead; of a 3D Gaussian, the projection is linear.

    Args:
        means, quaternions: [N, 3], [N, 4] wxyz.
        scales: [N, 2] of surfels or [N, 3] of 3D Gaussians, standard deviations.
    """
    frames = rotation_matrices(quaternions)[:, :, : scales.shape[1]] * scales[:, None]
    # Written out: matrix products this narrow take cuBLAS many times as long.
    axes = [x * frames[:, 0] + y * frames[:, 1] + z * frames[:, 2] for x, y, z, _ in camera.world_to_camera[:3]]
    center = [x * means[:, 0] + y * means[:, 1] + z * means[:, 2] + t for x, y, z, t in camera.world_to_camera[:3]]
    square = _surfel_square if scales.shape[1] == 2 else _gaussian_square
    (x, y), reach = square(center, axes, camera)
    columns, rows = (-(-size // TILE) * TILE for size in (camera.width, camera.height))
    beside = (x + reach >= 1) & (x - reach < columns) & (y + reach >= 1) & (y - reach < rows)
    return (center[2] > near) & beside


def _surfel_square(center: list[Tensor], axes: list[Tensor], camera: Camera) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Middle, and half the longer edge in whole pixels, of the box around three standard deviations of surfels.

    The box of a conic, from its dual (2D Gaussian Splatting, App. A): right where that is an ellipse.

    Args:
        center: x, y, z [N] in the camera's frame.
        axes: x, y, z [N, 2] of the two standard deviations there.

    Returns:
        Pixels from the first pixel's center, [N] each, and [N].
    """
    z, deep = center[2], axes[2]
    curvature = REACH**2 * deep.square().sum(1) - z.square()
    middles, halves = [], []
    for axis in (0, 1):
        focal, offset = camera.intrinsics[axis, axis], camera.intrinsics[axis, 2] - 0.5
        at, across = focal * center[axis] + offset * z, focal * axes[axis] + offset * deep
        middle = (REACH**2 * (across * deep).sum(1) - at * z) / curvature
        square = middle.square() - (REACH**2 * across.square().sum(1) - at.square()) / curvature
        middles.append(middle)
        halves.append(square.clamp_min(LEAST_BOX).sqrt())
    return (middles[0], middles[1]), torch.maximum(*halves).clamp_min(LEAST_REACH).ceil()


def _gaussian_square(center: list[Tensor], axes: list[Tensor], camera: Camera) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """The same of 3D Gaussians, `axes` [N, 3] each: three standard deviations of the wider axis of their projection.

    The projection is linear around the center (EWA Splatting, Zwicker et al. 2002), or around what lies at 1.3 times
    the half picture.
    """
    middles, spans = [], []
    for axis, size in ((0, camera.width), (1, camera.height)):
        focal, offset = camera.intrinsics[axis, axis], camera.intrinsics[axis, 2] - 0.5
        slope = center[axis] / center[2]
        middles.append(focal * slope + offset)
        most = BESIDE * 0.5 * size / focal
        slope = torch.minimum(torch.maximum(slope, -most), most)
        spans.append((focal / center[2])[:, None] * (axes[axis] - slope[:, None] * axes[2]))
    wide, high = (span.square().sum(1) + LOW_PASS for span in spans)
    across = (spans[0] * spans[1]).sum(1)
    mean = 0.5 * (wide + high)
    spread = (mean.square() - (wide * high - across.square())).clamp_min(LEAST_SPREAD).sqrt()
    return (middles[0], middles[1]), (REACH * (mean + spread).sqrt()).ceil()
