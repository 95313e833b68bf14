"""Which views train and which test."""

from __future__ import annotations

from itertools import pairwise

from envgs_bench.core import View

from .settings import DatasetError

TEST_EVERY = 8


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
