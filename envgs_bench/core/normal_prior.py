"""NormalPrior: what all training views together say of their estimated normals, for methods that learn from these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from .scene import View


@dataclass(frozen=True)
class NormalPrior:
    """Normals that agree, how much they are worth, and where what a view shows may not lie on them.

    Cells are those of a regular grid over a view's picture, [C, C] bool by rows and columns, on the CPU.

    Attributes:
        agreed: a training view -> the view with its normals in agreement with the others', on the device it is on.
        weight: of the normals in a loss, in (0, 1]: the inverse of the variance that is left.
        seen_through: by views' names the cells of flat mirrors and glass: nothing else looks like these.
        maybe_seen_through: these, and cells that curved mirrors look like here and there.
        notes: what differs from the normals as given, a sentence each.
    """

    agreed: Callable[[View], View]
    weight: float = 1.0
    seen_through: Mapping[str, Tensor] = field(default_factory=dict)
    maybe_seen_through: Mapping[str, Tensor] = field(default_factory=dict)
    notes: Sequence[str] = ()


def pixels_in(cells: Tensor, height: int, width: int) -> Tensor:
    """Which pixels of a picture lie in the cells [C, C], [H, W]."""
    rows, columns = (
        torch.arange(size, device=cells.device) * count // size
        for size, count in zip((height, width), cells.shape, strict=True)
    )
    return cells[rows[:, None], columns]


def normals_outside(normal: Tensor, cells: Tensor) -> Tensor:
    """A view's normals [H, W, 3], 0 in the cells [C, C]."""
    return torch.where(pixels_in(cells.to(normal.device), *normal.shape[:2])[..., None], 0.0, normal)


def share_of(cells: Mapping[str, Tensor], views: int) -> float:
    """The share of what so many views show that these cells are."""
    return sum(float(where.float().mean()) for where in cells.values()) / views
