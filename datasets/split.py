"""Which views train, which test, and which of the training views may validate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from .errors import DatasetError

if TYPE_CHECKING:  # which files a capture is made from is found without torch
    from envgs_bench.core import Scene, View

Item = TypeVar("Item")

TEST_EVERY = VALIDATION_EVERY = 8


def split_views(views: list[View], source: str) -> tuple[list[View], list[View]]:
    """Training and test views: every eighth tests, from the first, in the order given.

    That is the order of the pictures' paths, as other programs split them: `cam1/9` comes before `cam10/0`, and
    `cam1_9` would come after `cam10_0`. `source` names the data in errors.

    Raises:
        DatasetError: fewer than two views, or two of one name.
    """
    twice = sorted(name for name, count in Counter(view.name for view in views).items() if count > 1)
    if twice:
        raise DatasetError(f"{source}: several images are called {', '.join(twice[:5])}; rename them")
    if len(views) < 2:
        raise DatasetError(
            f"{source}: {len(views)} image{'s' * (len(views) != 1)}, expected at least two: "
            f"one view of every {TEST_EVERY} is kept for testing"
        )
    train = [view for index, view in enumerate(views) if index % TEST_EVERY]
    return train, views[::TEST_EVERY]


def validation_of(train: Sequence[Item]) -> list[Item]:
    """Those of the training views, or of what they are made from, that may validate: every eighth, from the first.

    As test views are chosen of all. So where views follow a path, its end validates too, and is as hard as that of the
    test views: from its end a camera sees what no other one does.
    """
    return list(train[::VALIDATION_EVERY])


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
    train = taken_out(scene.train, val)
    if not train:
        raise DatasetError(
            f"dataset.validation=true: {scene.name} has {len(scene.train)} for training and validation, expected "
            "at least two: one validates, and the others are learned from"
        )
    return replace(scene, train=train, val=val)
