"""Where Gaussians start: at structure-from-motion points, or at random in a box around them.

SciPy's spatial module takes 0.3 s to import: where methods are only listed or checked, it is not.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .ordering import morton_codes
from .parameters import inverse_sigmoid, sh_from_rgb

Orientation = Literal["surface", "random", "positive", "world"]

NEIGHBORS = 3
PLANE_NEIGHBORS = 8
MIN_SCALE = 1e-5  # × scene radius: coincident points still need an extent


def evenly_thinned(points: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Rows of `count` of the points [N, 3], ascending, as dense everywhere in proportion to the points as can be.

    Every N / count-th point along a Z-order curve through them (Morton 1966), from a random start.
    """
    start = torch.rand((), generator=generator, dtype=torch.float64)
    places = ((torch.arange(count) + start) * (len(points) / count)).long().clamp_max(len(points) - 1)
    return _along_z_order(points.detach().cpu())[places].sort().values.to(points.device)


def _along_z_order(points: Tensor) -> Tensor:
    """The points' rows in the order of their cells' interleaved bits, 2¹⁶ cells an axis."""
    low, high = points.double().aminmax(dim=0)
    cells = ((points.double() - low) / (high - low).max().clamp_min(1e-30) * 0xFFFF).long()
    return torch.from_numpy(morton_codes(cells.numpy())).argsort(stable=True)


def neighbor_distance(points: Tensor, radius: float) -> Tensor:
    """RMS distance of each of the points [N, 3] to its 3 nearest neighbors, [N], at least 1e-5 of `radius`.

    A point with fewer neighbors uses those it has; a lone point gets 1 % of `radius`.
    """
    from scipy.spatial import cKDTree

    count = min(NEIGHBORS, len(points) - 1)
    if count < 1:
        return torch.full((len(points),), 0.01 * radius, dtype=points.dtype, device=points.device)
    positions = points.detach().cpu().double().numpy()
    distances = cKDTree(positions).query(positions, k=count + 1, workers=-1)[0][:, 1:]
    rms = torch.from_numpy(np.sqrt((distances**2).mean(axis=1)))
    return rms.clamp_min(MIN_SCALE * radius).to(points)


def local_orientation(points: Tensor) -> Tensor:
    """Quaternions [N, 4] (wxyz) whose third axis is the normal of the plane through a point's neighbors.

    The normal is the direction in which a point and its 8 nearest neighbors vary least (principal components).
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    positions = points.detach().cpu().double().numpy()
    count = min(PLANE_NEIGHBORS + 1, len(positions))
    around = positions[cKDTree(positions).query(positions, k=[*range(1, count + 1)], workers=-1)[1]]
    centered = around - around.mean(axis=1, keepdims=True)
    axes = np.linalg.eigh(centered.transpose(0, 2, 1) @ centered)[1][:, :, ::-1].copy()
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]  # a rotation, not a reflection
    return torch.from_numpy(Rotation.from_matrix(axes).as_quat(scalar_first=True)).to(points)


def initial_orientation(points: Tensor, orientation: Orientation, generator: torch.Generator) -> Tensor:
    """Quaternions [N, 4] (wxyz) of primitives at the points [N, 3].

    "surface": along the surface that the points lie on; "random": uniform over all rotations; "positive": four numbers
    between 0 and 1, not normalized, which prefers some rotations (2DGS's released code); "world": along the axes.
    """
    if orientation == "surface":
        return local_orientation(points)
    if orientation == "positive":
        return torch.rand(len(points), 4, generator=generator).to(points)
    if orientation == "random":
        return torch.randn(len(points), 4, generator=generator).to(points)
    return torch.tensor([1.0, 0, 0, 0]).to(points).repeat(len(points), 1)


def initial_tensors(
    points: Tensor,  # [N, 3]
    colors: Tensor,  # [N, 3] in [0, 1]
    quaternions: Tensor,  # [N, 4] wxyz
    *,
    axes: int,
    sh_degree: int,
    opacity: float,
    beta: float | None,
    radius: float,
    scale: float = 1.0,
) -> dict[str, Tensor]:
    """`GaussianParameters`' tensors for one primitive at each point.

    Isotropic, with `scale` × the neighbor distance as scale on its `axes` (2: surfels, 3: 3D Gaussians), one opacity,
    the point's color from every side, and, where `beta` is given, that blending weight.
    """
    dc, rest = sh_from_rgb(colors, sh_degree)
    log_scales = neighbor_distance(points, radius).log() + math.log(scale)
    tensors = {
        "means": points.clone(),
        "quaternions": quaternions,
        "log_scales": log_scales[:, None].repeat(1, axes),
        "opacity_logits": inverse_sigmoid(torch.full_like(points[:, 0], opacity)),
        "sh_dc": dc,
        "sh_rest": rest,
    }
    if beta is not None:
        tensors["beta_logits"] = inverse_sigmoid(torch.full_like(points[:, :1], beta))
    return tensors


def half_diagonal(points: Tensor) -> float:
    """Of the box of the points [N, 3], at least 1e-3: the scene scale where all cameras share one center."""
    return max(0.5 * float((points.amax(0) - points.amin(0)).norm()), 1e-3)


def quantile_box(points: Tensor, quantile: float) -> tuple[Tensor, Tensor]:
    """Corners [3], [3] of the axis-aligned box that holds the central `quantile` of the points' range on each axis.

    EnvGS paper, Sec. 4.3: with 0.995 the box reaches from the 0.25 % to the 99.75 % quantile. An axis on which the
    points have no extent is widened to a thousandth of the longest.
    """
    positions = points.detach().cpu().double().numpy()
    low, high = _central(positions, quantile)
    return _with_extent(low, high, points)


def box_inside(points: Tensor, quantile: float) -> tuple[Tensor, Tensor]:
    """Corners [3], [3] of the smallest axis-aligned box around the points that lie in `quantile_box`.

    Where no point lies within it on all axes it is that box itself. An axis without extent is widened, as there.
    """
    positions = points.detach().cpu().double().numpy()
    low, high = _central(positions, quantile)
    inside = positions[((positions >= low) & (positions <= high)).all(axis=1)]
    if len(inside):
        low, high = inside.min(axis=0), inside.max(axis=0)
    return _with_extent(low, high, points)


def _central(positions: np.ndarray, quantile: float) -> np.ndarray:
    tail = (1 - quantile) / 2
    return np.quantile(positions, [tail, 1 - tail], axis=0)


def _with_extent(low: np.ndarray, high: np.ndarray, points: Tensor) -> tuple[Tensor, Tensor]:
    extent = (high - low).max()
    flat = (high - low) < 1e-3 * extent
    center = (low + high) / 2
    low = np.where(flat, center - 5e-4 * extent, low)
    high = np.where(flat, center + 5e-4 * extent, high)
    return torch.from_numpy(low).to(points), torch.from_numpy(high).to(points)


def random_points_in_grid(low: Tensor, high: Tensor, grid: int, per_cell: int, generator: torch.Generator) -> Tensor:
    """`per_cell` uniform random points in each of the grid³ equal cells of the box, [grid³ · per_cell, 3]."""
    axis = torch.arange(grid)
    cells = torch.cartesian_prod(axis, axis, axis).repeat_interleave(per_cell, dim=0)
    unit = (cells + torch.rand(cells.shape, generator=generator)) / grid
    return low + unit.to(low) * (high - low)


def random_points_on_sphere(center: Tensor, radius: float, count: int, generator: torch.Generator) -> Tensor:
    """`count` points [count, 3] at `radius` around `center` [3], uniform in direction."""
    directions = functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    return center + radius * directions.to(center)
