"""Estimated normals brought into agreement: each view's turned, smoothly over its picture, to what all views say.

What views say of one point has to be one normal. Estimators err by whole surfaces and in each view otherwise, so what
most views say of a point is nearer to the truth than any of them. By how much a view's normals are turned against that
is known where it shows the scene's points, and so about what lies between them: mirrors too, which have none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from envgs_bench.core.vectors import rotated, unit

from .observations import Observations

IN_AGREEMENT = 1.5  # degrees from the points' normals up to which a view's are left, to the last bit
COLUMNS = 6  # cells of a picture's width, at whose corners rotations are found; as many to its height as make squares
ROUGHNESS = 0.3  # weight of the squared difference of neighboring corners' rotations, against that of one observation
SIZE = 0.1  # weight of the squared rotation of each corner
LEAST_VIEWS = 4  # that must show a point, for most of them to be right
LEAST_POINTS = 30  # that a view must show for its normals to be turned
MOST_AGREE = 0.6  # share of a point's views that must be near its normal: at an edge each sees its own side
ROUNDS = 3
SPREAD = 1.5  # × the median angle: Geman and McClure's scale
LEAST_SCALE, FIRST_SCALE, LARGEST_SCALE = 4.5, 20.0, 60.0  # degrees
LOOKS = 4  # at a point's views for its normal, each weighing them by the look before
POINTS_AT_ONCE = 256


@dataclass(frozen=True)
class NormalAgreement:
    """Normals at a scene's points once they agree, and what that takes of the views.

    Attributes:
        normals: [V, P, 3] of V views at P points, world frame, of length 1; 0 where a view has none.
        corrections: by views' names the rotation vectors [R + 1, C + 1, 3], world frame, in radians, at the corners of
            R × C cells of the picture (`corrected`); none of views that agreed as given.
    """

    normals: Tensor
    corrections: Mapping[str, Tensor] = field(default_factory=dict)


def normal_agreement(observations: Observations, normals: Tensor) -> NormalAgreement:
    """That of the views' normals [V, P, 3] at the points, 0 where a view has none.

    In turn each point's normal is found from its views', turned as far as is known, and then each view's rotations from
    the points'. Both are robust, since a view may show something before a point, and edges have two sides. Rotations
    are bilinear between the corners of cells, and the least-squares ones by what is left of the angles, with penalties
    on their roughness and size.
    """
    given, has = unit(normals), normals.any(dim=-1)
    seen = has & (has.sum(dim=0) >= LEAST_VIEWS)
    if observations.colorless or not seen.any():
        return NormalAgreement(given)
    bends = [_Bend.over(observations, view, has[view]) for view in range(len(given))]
    turned, corners = given.clone(), [bend.still() for bend in bends]
    common = _common(given, seen, _medoids(given, seen), FIRST_SCALE)
    for _ in range(ROUNDS):
        scale = _scale(_degrees(turned, common)[seen])
        common = _common(turned, seen, common, scale)
        angles = _degrees(turned, common)
        one_sided = ((angles < 2 * scale) & seen).sum(dim=0) > MOST_AGREE * seen.sum(dim=0)
        for view, bend in enumerate(bends):
            corners[view] = bend.fitted(given[view], turned[view], common, seen[view] & one_sided)
            turned[view] = bend.turned(given[view], corners[view])
    named = zip(observations.views, corners, strict=True)
    return NormalAgreement(turned, {view.name: each for view, each in named if each.any()})


def corrected(normals: Tensor, corners: Tensor) -> Tensor:
    """A view's normals [H, W, 3] turned by its `NormalAgreement.corrections` [R + 1, C + 1, 3]; 0 stays 0."""
    across, down = (
        _hats((torch.arange(size) + 0.5) / size, count - 1).to(normals)
        for size, count in zip((normals.shape[1], normals.shape[0]), (corners.shape[1], corners.shape[0]), strict=True)
    )
    return rotated(normals, torch.einsum("hr,wc,rck->hwk", down, across, corners.to(normals)))


@dataclass(frozen=True)
class _Bend:
    """Rotations over one view's picture.

    Attributes:
        rows: [K] indices of the points where the view has normals.
        shares: [K, (R + 1)·(C + 1)] of each corner in the rotation at each of these.
        penalty: square matrix of all corners' three components.
        shape: (R + 1, C + 1).
    """

    rows: Tensor
    shares: Tensor
    penalty: Tensor
    shape: tuple[int, int]

    @classmethod
    def over(cls, observations: Observations, view: int, has: Tensor) -> _Bend:
        """That of a view with normals at the points where `has` [P]."""
        camera, rows = observations.views[view].camera, torch.nonzero(has)[:, 0]
        down, across = max(1, round(COLUMNS * camera.height / camera.width)), COLUMNS
        x, y = (observations.pixels[view, rows] / torch.tensor([camera.width, camera.height])).unbind(dim=-1)
        shares = (_hats(y, down)[:, :, None] * _hats(x, across)[:, None]).flatten(1)
        rough_down, rough_across = (step.T @ step for step in (torch.eye(n + 1).diff(dim=0) for n in (down, across)))
        rough = torch.kron(rough_down, torch.eye(across + 1)) + torch.kron(torch.eye(down + 1), rough_across)
        penalty = torch.kron(ROUGHNESS * rough + SIZE * torch.eye(len(rough)), torch.eye(3))
        return cls(rows, shares, penalty, (down + 1, across + 1))

    def still(self) -> Tensor:
        return torch.zeros(*self.shape, 3)

    def fitted(self, given: Tensor, turned: Tensor, common: Tensor, known: Tensor) -> Tensor:
        """Corners' rotations [R + 1, C + 1, 3] from the given to the common normals.

        0 where these agree, or too few are there. `turned` is what the last rotations made of the given. All three are
        [P, 3], and `known` [P] says where the common ones are.
        """
        inside = known[self.rows]
        rows, shares = self.rows[inside], self.shares[inside]
        given, common, angles = given[rows], common[rows], _degrees(turned[rows], common[rows])
        if len(rows) < LEAST_POINTS or _degrees(given, common).median() <= IN_AGREEMENT:
            return self.still()
        weights = _weights(angles, _scale(angles))
        axis = torch.linalg.cross(given, common)
        wanted = unit(axis) * torch.atan2(axis.norm(dim=-1), (given * common).sum(dim=-1))[:, None]
        # About itself a normal does not turn: rotations count by I − nnᵀ, which is its own square and keeps `wanted`.
        turning = (torch.eye(3) - given[:, :, None] * given[:, None]) * weights[:, None, None]
        effects = shares[:, :, None] * turning.flatten(1)[:, None]  # [K, corners, 9]
        normal = (shares.T @ effects.flatten(1)).unflatten(1, (-1, 3, 3)).transpose(1, 2).flatten(2).flatten(0, 1)
        falls = shares.T @ (wanted * weights[:, None])  # [corners, 3]
        corners = torch.linalg.solve(normal + self.penalty, falls.flatten())
        return corners.reshape(*self.shape, 3)

    def turned(self, given: Tensor, corners: Tensor) -> Tensor:
        """The view's normals [P, 3] with these rotations."""
        turned = given.clone()
        turned[self.rows] = rotated(given[self.rows], self.shares @ corners.flatten(0, 1))
        return turned


def _hats(position: Tensor, cells: int) -> Tensor:
    """Shares [..., cells + 1] of the corners of cells in what is interpolated at a position in [0, 1]."""
    return (1 - (position[..., None] * cells - torch.arange(cells + 1)).abs()).clamp_min(0)


def _medoids(normals: Tensor, seen: Tensor) -> Tensor:
    """Of each point's normals [V, P, 3] the one that most others are near, [P, 3]."""
    found = []
    for some, shown in zip(normals.split(POINTS_AT_ONCE, dim=1), seen.split(POINTS_AT_ONCE, dim=1), strict=True):
        some, shown = some.transpose(0, 1), shown.T  # [P, V, 3]
        near = some @ some.mT > torch.tensor(FIRST_SCALE).deg2rad().cos()
        best = (near & shown[:, None] & shown[:, :, None]).sum(dim=-1).argmax(dim=-1)
        found.append(some[torch.arange(len(some)), best])
    return torch.cat(found)


def _common(normals: Tensor, seen: Tensor, common: Tensor, scale: float) -> Tensor:
    """What most of each point's normals [V, P, 3] are near, [P, 3], from a first guess."""
    for _ in range(LOOKS):
        weights = _weights(_degrees(normals, common), scale) * seen
        common = unit((normals * weights[..., None]).sum(dim=0))
    return common


def _scale(degrees: Tensor) -> float:
    return float((SPREAD * degrees.median()).clamp(LEAST_SCALE, LARGEST_SCALE))


def _degrees(normals: Tensor, common: Tensor) -> Tensor:
    return (normals * common).sum(dim=-1).clamp(-1, 1).acos().rad2deg()


def _weights(degrees: Tensor, scale: float) -> Tensor:
    return (1 + (degrees / scale).square()).pow(-2)
