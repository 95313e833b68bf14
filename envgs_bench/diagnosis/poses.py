"""Whether training views look where their poses say: the turn of each at which it shows the points in their colors.

Points that structure from motion found have the colors of the pictures that show them. A view whose pose is right
agrees with them best as it is, one whose pose is off once it is turned. The turn is found by direct image alignment
(Baker and Matthews, IJCV 2004): robust Gauss-Newton steps, on coarse pictures and then on finer ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from envgs_bench.core import View

from .observations import Observations

SIZES = (32, 64, 96)  # pixels along both sides of what a picture is resized to, one after the other
ROUNDS = 8  # Gauss-Newton steps at each size
DAMPING = 0.01  # × the diagonal of the normal equations
POINTS_A_VIEW = 1_500  # at most
FEWEST = 30  # points that a view is judged by
LEAST_SCALE = 0.01  # of differences of sRGB values: smaller ones all count fully


@dataclass(frozen=True)
class Alignment:
    """How each of V training views is to be turned.

    Attributes:
        turns: [V, 3, 3] rotations after the views' own, in the cameras' axes.
        gains: [V] the shares by which the median differences to the points' colors then fall; 0 where they do not.
    """

    turns: Tensor
    gains: Tensor

    @property
    def gain(self) -> float:
        """That of the median view."""
        return float(self.gains.median())

    @property
    def degrees(self) -> float:
        """By how much the median view is to be turned."""
        cosines = (self.turns.diagonal(dim1=1, dim2=2).sum(dim=1) - 1) / 2
        return float(cosines.clamp(-1, 1).acos().rad2deg().median())


@dataclass(frozen=True)
class _Sights:
    """What V views look at: up to K points each, in the camera's axes.

    Attributes:
        points, colors: [V, K, 3].
        known: [V, K] whether there is such a point.
        projection: [V, 2, 3] from (x/z, y/z, 1) to positions in the picture, −1 to 1 along both sides.
    """

    points: Tensor
    colors: Tensor
    known: Tensor
    projection: Tensor

    def to(self, device: torch.device | str) -> _Sights:
        return _Sights(*(values.to(device) for values in vars(self).values()))


@torch.no_grad()
def alignment(observations: Observations, device: torch.device | str = "cpu") -> Alignment:
    """The turns that make the views agree with the points' colors; none of a view that shows too few points.

    Args:
        device: where all pixels and points are looked at; what is found is on the CPU.
    """
    turns = none = torch.eye(3, device=device).repeat(len(observations.views), 1, 1)
    if not observations.shown.any():
        return Alignment(none.cpu(), torch.zeros(len(none)))
    sights = _sights(observations).to(device)
    pictures = torch.cat([_resized(view.rgb(device).permute(2, 0, 1)[None], SIZES[-1]) for view in observations.views])
    for size in SIZES:
        maps = _with_gradients(_resized(pictures, size))
        for _ in range(ROUNDS):
            turns = _step(sights, maps, turns) @ turns
    before, after = (_median_difference(_compared(sights, maps, each)[0]) for each in (none, turns))
    gains = 1 - after / before.clamp_min(1e-6)
    better = (sights.known.sum(dim=1) >= FEWEST) & (gains > 0)  # NaN is not: the picture is not finite
    return Alignment(torch.where(better[:, None, None], turns, none).cpu(), torch.where(better, gains, 0.0).cpu())


def turned(view: View, turn: Tensor) -> View:
    """The view with a rotation [3, 3] after its own, about its center. Normals, which are its camera's, follow."""
    pose = view.camera.world_to_camera.clone()
    pose[:3] = turn.to(pose) @ pose[:3]
    normal = view.normal
    if normal is not None:
        normal = normal @ (view.camera.world_to_camera[:3, :3].T @ pose[:3, :3]).to(normal)
    return replace(view, camera=replace(view.camera, world_to_camera=pose), normal=normal)


def _sights(observations: Observations) -> _Sights:
    points, colors, projections = [], [], []
    for index, view in enumerate(observations.views):
        camera = view.camera
        in_camera = observations.points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        rows = torch.nonzero(observations.unhidden[index])[:, 0]
        rows = rows[:: len(rows) // POINTS_A_VIEW + 1]
        points.append(in_camera[rows])
        colors.append(observations.colors[rows])
        scale = 2 / camera.intrinsics.new_tensor([[camera.width], [camera.height]])
        projections.append(camera.intrinsics[:2] * scale - camera.intrinsics.new_tensor([0.0, 0.0, 1.0]))
    counts = torch.tensor([len(each) for each in points])
    known = torch.arange(int(counts.max())) < counts[:, None]
    points_of_all = pad_sequence(points, batch_first=True, padding_value=1.0)
    colors_of_all = pad_sequence(colors, batch_first=True)
    return _Sights(points_of_all, colors_of_all, known, torch.stack(projections))


def _resized(pictures: Tensor, size: int) -> Tensor:
    return functional.interpolate(pictures, (size, size), mode="bilinear", antialias=True)


def _with_gradients(pictures: Tensor) -> Tensor:
    """[V, 9, S, S] of pictures [V, 3, S, S]: colors, and how they change along x and y from −1 to 1."""
    half = pictures.shape[-1] / 2
    down, right = torch.gradient(pictures, dim=(2, 3))
    return torch.cat([pictures, right * half, down * half], dim=1)


def _compared(sights: _Sights, maps: Tensor, turns: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor]]:
    """What turned views show of the points.

    Returns:
        [V, K, 3] differences to the points' colors but for the view's own exposure, NaN outside the picture; where the
        points are, [V, K, 2] as x/z and y/z; and how colors change there along x and along y, each [V, K, 3].
    """
    points = sights.points @ turns.mT
    at = points[..., :2] / points[..., 2:].clamp_min(1e-6)
    scale, middle = sights.projection.split([2, 1], dim=2)
    pixels = at @ scale.mT + middle.mT
    inside = sights.known & (points[..., 2] > 1e-6) & (pixels.abs() < 1).all(dim=-1)
    pixels = torch.where(inside[..., None], pixels, 0.0)
    values = functional.grid_sample(maps, pixels[:, :, None], align_corners=False)[..., 0].mT
    differences = torch.where(inside[..., None], values[..., :3] - sights.colors, torch.nan)
    differences = differences - differences.nanmedian(dim=1, keepdim=True).values
    return differences, torch.where(inside[..., None], at, 0.0), values[..., 3:].split(3, dim=-1)


def _median_difference(differences: Tensor) -> Tensor:
    """[V] of differences [V, K, 3]; NaN where a view has none."""
    return differences.abs().mean(dim=-1).nanmedian(dim=1).values


def _step(sights: _Sights, maps: Tensor, turns: Tensor) -> Tensor:
    """A Gauss-Newton step: small rotations [V, 3, 3] after the turns.

    A rotation by ω moves a point by ω × p, so that x/z = u and y/z = v change by (−uv, 1 + u², −v) · ω and
    (−1 − v², uv, u) · ω. Differences count as of Geman and McClure, by the scale of the view's median.
    """
    differences, at, (along_x, along_y) = _compared(sights, maps, turns)
    scale = _median_difference(differences).clamp_min(LEAST_SCALE)
    weights = (1 + (differences.abs().mean(dim=-1) / scale[:, None]).square()).pow(-2).nan_to_num(0.0)
    u, v = at.unbind(dim=-1)
    moves = torch.stack([-u * v, -1 - v * v, 1 + u * u, u * v, -v, u], dim=-1).unflatten(-1, (3, 2))
    moves = (moves.flatten(1, 2) @ sights.projection[:, :, :2].mT).unflatten(1, (-1, 3))  # [V, K, 3 axes, 2]
    effects = along_x[..., None] * moves[..., None, :, 0] + along_y[..., None] * moves[..., None, :, 1]
    weighted = (effects * weights[..., None, None]).flatten(1, 2)
    normal = weighted.mT @ effects.flatten(1, 2)
    normal = normal + torch.diag_embed(DAMPING * normal.diagonal(dim1=1, dim2=2) + 1e-4)
    falls = weighted.mT @ differences.nan_to_num(0.0).flatten(1, 2)[..., None]
    x, y, z = torch.linalg.solve(normal, -falls)[..., 0].unbind(dim=1)
    o = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=1).unflatten(1, (3, 3)))
