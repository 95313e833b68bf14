"""Views whose normals are mirrored are told by what views agree on, not by what some of them see through glass."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest
import torch
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.core.vectors import unit
from envgs_bench.diagnosis.mirrored_normals import mirrored_normals, mirrored_views
from envgs_bench.diagnosis.observations import Observations

VIEWS, POINTS = 12, 60
SHALLOW = 0.1  # sine of the angle between floor and cameras' axes, by which mirroring changes what is seen of it


def seen(mirrored: tuple[int, ...], through_glass: tuple[int, ...] = ()) -> Observations:
    """Views all around of a floor and a wall, in order or mirrored; where some see the wall others see glass before it.

    The views `through_glass` see normals there that are 100° from the others', and mirrored 60°.
    """
    turns = torch.arange(VIEWS) / VIEWS * 2 * torch.pi
    right = unit(torch.stack([turns.cos(), turns.sin(), torch.full((VIEWS,), SHALLOW)], dim=1))
    views = []
    for own in right:
        pose = torch.eye(4)
        pose[0, :3] = own
        views.append(SimpleNamespace(name=str(len(views)), camera=SimpleNamespace(world_to_camera=pose)))
    floor, wall = torch.eye(3)[2], torch.eye(3)[0]
    normals = floor.repeat(VIEWS, POINTS, 1)
    if through_glass:
        normals[:, : POINTS // 2] = wall
        for index in through_glass:
            normals[index, : POINTS // 2] = _apart(right[index], wall)
    for index in mirrored:
        normals[index] = mirrored_normals(normals[index], cast(View, views[index]))
    shown = torch.ones(VIEWS, POINTS, dtype=torch.bool)
    return cast(Observations, SimpleNamespace(views=views, seen_normals=normals, unhidden=shown))


def _apart(right: Tensor, other: Tensor) -> Tensor:
    """A normal 100° from another, of which the mirror image is 60° from it."""
    across = unit(other - (other @ right) * right)
    given, after = torch.tensor([100.0, 60.0]).deg2rad().cos()
    along, beside = (given - after) / 2 / (other @ right), (given + after) / 2 / (other @ across)
    rest = (1 - along.square() - beside.square()).sqrt()
    return along * right + beside * across + rest * torch.linalg.cross(right, across)


@pytest.mark.parametrize("mirrored", [(), (3,), (1, 4, 7), tuple(range(VIEWS))])
def test_views_are_named_though_mirroring_hardly_changes_them(mirrored: tuple[int, ...]) -> None:
    """By 2 asin 0.1 = 11°, which is a loss of 2 % of a cosine."""
    assert mirrored_views(seen(mirrored)).views == [str(index) for index in mirrored]


@pytest.mark.parametrize("mirrored", [(), (1, 4, 7)])
def test_what_is_seen_through_glass_says_nothing_of_a_view(mirrored: tuple[int, ...]) -> None:
    assert mirrored_views(seen(mirrored, through_glass=(2, 5))).views == [str(index) for index in mirrored]
