"""What test views show that some training view shows too: what lies elsewhere no method can know.

Scores inside this region leave out what had to be guessed (Gao et al., Monocular Dynamic View Synthesis: A Reality
Check, NeurIPS 2022, who find co-visible pixels by optical flow).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .world import World

Array = NDArray[np.floating[Any]]

REACHED = 0.999  # of the way to a point, from which a ray that is stopped was stopped by the point's own surface


def covisible(world: World, camera: Camera, depth: Array, others: Sequence[Camera]) -> NDArray[np.bool_]:
    """[H, W]: whether what a pixel's center shows lies in the picture of some of the `others`, with nothing before it.

    Args:
        depth: [H, W] the camera's, its frame's z, 0 where it sees the sky: which is seen where a direction is.
    """
    origins, directions = (rays.reshape(-1, 3).double().numpy() for rays in camera.rays())
    met = depth.reshape(-1, 1) > 0
    points = np.where(met, origins + depth.reshape(-1, 1) * directions, directions)
    found = np.zeros(len(points), dtype=np.bool_)
    for other in others:
        left = np.flatnonzero(~found)
        toward = points[left] - met[left] * other.center.double().numpy()
        inside = _in_picture(other, toward)
        left, toward = left[inside], toward[inside]
        origin = np.broadcast_to(other.center.numpy(), toward.shape)
        hits = world.cast(origin.astype(np.float32), toward.astype(np.float32))
        found[left] = ~hits.met | (met[left, 0] & (hits.distance > REACHED))
    return found.reshape(depth.shape)


def _in_picture(camera: Camera, directions: Array) -> NDArray[np.bool_]:
    """[R] whether these directions [R, 3] from the camera's center meet its picture."""
    to_pixel = (camera.intrinsics.double() @ camera.world_to_camera[:3, :3].double()).numpy()
    x, y, z = np.einsum("ri,ji->jr", directions, to_pixel)  # without BLAS, as in render._transformed
    return (z > 0) & (x >= 0) & (y >= 0) & (x < camera.width * z) & (y < camera.height * z)
