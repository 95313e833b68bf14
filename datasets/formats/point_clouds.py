"""Point clouds: what methods start from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from envgs_bench.ply_file import number_names, read_elements

from ..errors import DatasetError

if TYPE_CHECKING:  # which files a capture is made from is found without torch
    import torch

    from envgs_bench.core import Placement

SH_BAND_0 = 0.28209479177387814  # √(1/4π)
GRAY = 0.5


class PointCloud(NamedTuple):
    """Points with their colors.

    Attributes:
        points: [P, 3] float64, the data's coordinates; float32 once placed in the scene's world.
        colors: [P, 3] float32 in [0, 1], sRGB.
    """

    points: torch.Tensor
    colors: torch.Tensor


def point_cloud(points: ArrayLike, colors: ArrayLike, source: Path) -> PointCloud:
    """The cloud of these points [P, 3] and colors [P, 3] in [0, 1]; `source` names them in errors.

    Raises:
        DatasetError: there is no point, one at infinity, where float32 does not reach, or one of another color.
    """
    import torch

    places = torch.as_tensor(np.asarray(points, dtype=np.float64))
    if not len(places):
        raise DatasetError(
            f"{source}: holds no points to start from; triangulate some, as colmap point_triangulator does"
        )
    infinite = int((~torch.isfinite(places.float()).all(dim=1)).sum())
    if infinite:
        raise DatasetError(
            f"{source}: {infinite} of {len(places)} points lie at infinity (no finite numbers); remove them, as colmap "
            "point_filtering does"
        )
    shades = np.asarray(colors, dtype=np.float64)
    odd = int((~((shades >= 0) & (shades <= 1)).all(axis=1)).sum())
    if odd:
        raise DatasetError(f"{source}: {odd} of {len(places)} points have colors outside of 0 to 255; export it again")
    return PointCloud(places, torch.as_tensor(shades).float())


def read_point_cloud(path: Path) -> PointCloud:
    """The vertices of a PLY file: x, y, z and red, green, blue, as bytes or as floats in [0, 1]; gray without colors.

    Raises:
        DatasetError: it cannot be read, has no such properties, or `point_cloud` refuses it.
    """
    try:
        vertices = read_elements(path)["vertex"]
    except (ValueError, KeyError) as error:
        raise DatasetError(f"{path}: cannot be read as a point cloud ({error}); export it again as PLY") from error
    names = number_names(vertices)
    if not {"x", "y", "z"} <= set(names):
        raise DatasetError(f"{path}: its vertices have {', '.join(names)}, expected x, y, z; export it again")
    points = np.stack([vertices[axis] for axis in "xyz"], axis=-1)
    if not {"red", "green", "blue"} <= set(names):
        return point_cloud(points, np.full_like(points, GRAY, dtype=np.float64), path)
    colors = np.stack([vertices[channel] for channel in ("red", "green", "blue")], axis=-1)
    return point_cloud(points, colors / 255 if colors.dtype.kind in "ui" else np.clip(colors, 0, 1), path)


@dataclass(frozen=True)
class RandomPoints:
    """Points evenly spread over a cube, almost gray, as 3DGS starts without structure from motion.

    There, colors are spherical harmonics' first coefficients in [0, 1/255): c = ½ + Y₀·random/255.

    Attributes:
        half: half the cube's edge, in the data's units.
        center: in the data's coordinates; where their world is moved, the cube is around its new origin instead.
    """

    count: int
    half: float
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0

    def placed(self, placement: Placement) -> PointCloud:
        """The points in the scene's world, float32."""
        moved = any(placement.shift)
        center = np.zeros(3) if moved else np.asarray(self.center) / placement.scale
        rng = np.random.default_rng(self.seed)
        points = center + self.half / placement.scale * rng.uniform(-1, 1, (self.count, 3))
        colors = GRAY + SH_BAND_0 * rng.uniform(0, 1, (self.count, 3)) / 255
        cloud = point_cloud(points, colors, Path("random points"))
        return cloud._replace(points=cloud.points.float())


def far_points(centers: torch.Tensor, count: int) -> PointCloud:
    """`count` gray points, evenly on a sphere around the cameras' centers [V, 3], twice as far out as the farthest.

    A background that structure from motion found nothing in has to begin somewhere.
    """
    import torch

    middle = centers.mean(0)
    radius = 2 * (centers - middle).norm(dim=1).max()
    turn = torch.arange(count, dtype=torch.float64) + 0.5
    height = 1 - 2 * turn / count
    angle = math.pi * (3 - math.sqrt(5)) * turn  # the golden angle: neighbors in number are never close
    across = (1 - height.square()).sqrt()
    directions = torch.stack([across * angle.cos(), across * angle.sin(), height], dim=1).float()
    return PointCloud(middle + radius * directions, torch.full((count, 3), GRAY))
