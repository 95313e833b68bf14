"""Which views train, which test, and which of the training views may validate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

from envgs_bench.core import Scene, View

from .errors import DatasetError

Item = TypeVar("Item")

TEST_EVERY = 8
VALIDATION_EVERY, FIRST_VALIDATION = 8, 3  # by the training views' indices: 3, 11, 19 …


def split_views(views: list[View], source: str) -> tuple[list[View], list[View]]:
    """Training and test views: sorted by name, every eighth tests, from the first.

    `source` names the data in errors.

    Raises:
        DatasetError: fewer than two views, or two of one name.
    """
    ordered = sorted(views, key=lambda view: view.name)
    names = [view.name for view in ordered]
    twice = sorted({a for a, b in pairwise(names) if a == b})
    if twice:
        raise DatasetError(f"{source}: several images are called {', '.join(twice[:5])}; rename them")
    if len(ordered) < 2:
        raise DatasetError(
            f"{source}: {len(ordered)} image{'s' * (len(ordered) != 1)}, expected at least two: "
            f"one view of every {TEST_EVERY} is kept for testing"
        )
    train = [view for index, view in enumerate(ordered) if index % TEST_EVERY]
    return train, ordered[::TEST_EVERY]


def validation_of(train: Sequence[Item]) -> list[Item]:
    """Those of the training views, or of what they are made from, that may validate: every eighth, the fourth first."""
    return list(train[FIRST_VALIDATION::VALIDATION_EVERY])


def taken_out(train: Sequence[View], val: Sequence[View]) -> list[View]:
    """What still trains where these validate."""
    names = {view.name for view in val}
    return [view for view in train if view.name not in names]


def without_normals(views: Sequence[View]) -> list[View]:
    """The views as scores are to see them where their normals are not exact."""
    return [replace(view, normal=None) for view in views]


def with_validation(scene: Scene) -> Scene:
    """The scene with `val`, or else every eighth training view, taken out of the training views.

    The latter without normals: nothing says that these are exact.

    Raises:
        DatasetError: there are too few training views.
    """
    val = scene.val or without_normals(validation_of(scene.train))
    if not val:
        raise DatasetError(
            f"dataset.validation=true: {scene.name} has {len(scene.train)} training views, expected at least "
            f"{FIRST_VALIDATION + 1}"
        )
    return replace(scene, train=taken_out(scene.train, val), val=val)
