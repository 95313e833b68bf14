"""Failure map: where a method wins, ties and loses, by what scenes are like, as a small cross-validated tree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .attribute_words import condition

Array = NDArray[np.float64]

DEPTH = 2
FEWEST = 3  # scenes in a leaf, and a tenth of all
FOLDS = 10


@dataclass(frozen=True)
class Leaf:
    """Scenes of one kind: the mean difference there, dB, and how many they are."""

    mean: float
    scenes: int


@dataclass(frozen=True)
class Question:
    """Whether an attribute is below a value, and what follows from either answer."""

    attribute: str
    below: float
    yes: Node
    no: Node


Node = Leaf | Question


@dataclass(frozen=True)
class FailureMap:
    """A tree, and what it is worth on scenes that it has not seen.

    Attributes:
        signs: share of the unseen scenes on which it tells who is ahead.
        majority: the same of who says for all scenes what holds of most.
        explained: share of the variance of the difference on unseen scenes; negative where the mean would be better.
        ranks: attribute -> Spearman's correlation of the difference with it.
    """

    tree: Node
    names: tuple[str, ...]  # of the attributes that it may ask for
    signs: float
    majority: float
    explained: float
    ranks: pd.Series


def failure_map(attributes: pd.DataFrame, difference: pd.Series) -> FailureMap:
    """The tree of the difference by the attributes, and its cross-validation in `FOLDS` folds.

    Args:
        attributes: a row a scene; columns that do not vary are left out.
        difference: dB, the same scenes in the same order.
    """
    varied = attributes.loc[:, attributes.nunique() > 1]
    x, y, names = varied.to_numpy(float), difference.to_numpy(float), list(varied.columns)
    guesses, majority = np.empty(len(y)), np.empty(len(y), bool)
    for index in range(min(FOLDS, len(y))):
        held = np.arange(len(y)) % min(FOLDS, len(y)) == index
        guesses[held] = guess(grown(x[~held], y[~held], names), names, x[held])
        majority[held] = (y[~held] > 0).mean() > 0.5
    total = float(((y - y.mean()) ** 2).sum())
    ranks = varied.rank().corrwith(difference.rank()).sort_values(key=abs, ascending=False)
    return FailureMap(
        grown(x, y, names),
        tuple(names),
        float(((guesses > 0) == (y > 0)).mean()),
        float((majority == (y > 0)).mean()),
        1 - float(((y - guesses) ** 2).sum()) / total if total else 0.0,
        ranks,
    )


def signs_told(found: FailureMap, attributes: pd.DataFrame, difference: pd.Series) -> float:
    """Share of other scenes on which the tree tells who is ahead."""
    names = list(found.names)
    told = guess(found.tree, names, attributes[names].to_numpy(float))
    return float(((told > 0) == (difference.to_numpy() > 0)).mean())


def grown(x: Array, y: Array, names: list[str], depth: int = DEPTH, fewest: int = 0) -> Node:
    """The tree of least squared error, question by question (Breiman et al. 1984); `x` is [scenes, attributes]."""
    fewest = fewest or max(FEWEST, round(len(y) / 10))
    best, error = None, float(((y - y.mean()) ** 2).sum()) - 1e-12
    for column in range(x.shape[1]) if depth and len(y) >= 2 * fewest else ():
        order = np.argsort(x[:, column], kind="stable")
        values, sorted_y = x[order, column], y[order]
        for cut in range(fewest, len(y) - fewest + 1):
            if values[cut - 1] == values[cut]:
                continue
            left = sum(float(((part - part.mean()) ** 2).sum()) for part in (sorted_y[:cut], sorted_y[cut:]))
            if left < error:
                best, error = (column, float((values[cut - 1] + values[cut]) / 2)), left
    if best is None:
        return Leaf(float(y.mean()), len(y))
    column, below = best
    yes = x[:, column] < below
    branches = (grown(x[side], y[side], names, depth - 1, fewest) for side in (yes, ~yes))
    return Question(names[column], below, *branches)


def guess(node: Node, names: list[str], x: Array) -> Array:
    """What the tree says of each row of `x`."""
    if isinstance(node, Leaf):
        return np.full(len(x), node.mean)
    yes = x[:, names.index(node.attribute)] < node.below
    return np.where(yes, guess(node.yes, names, x), guess(node.no, names, x))


def leaves(node: Node, conditions: tuple[str, ...] = ()) -> Iterator[tuple[Leaf, str]]:
    """Every leaf, and what scenes are like there: "" where the tree asks nothing."""
    if isinstance(node, Leaf):
        yield node, " and ".join(conditions)
        return
    for branch, below in ((node.yes, True), (node.no, False)):
        yield from leaves(branch, (*conditions, condition(node.attribute, node.below, below)))


def sentences(tree: Node, method: str, other: str, level: float) -> Iterator[str]:
    """One a leaf: whether the method wins, ties or loses there, by how much, and what scenes are like there.

    Args:
        level: a mean difference of no more is a tie, dB.
    """
    for leaf, where in leaves(tree):
        verdict = "ties with" if abs(leaf.mean) <= level else ("beats" if leaf.mean > 0 else "loses to")
        by = "" if verdict == "ties with" else f" by {abs(leaf.mean):.1f} dB"
        yield f"{f'Where {where}: ' if where else ''}{method} {verdict} {other}{by} ({leaf.scenes} scenes)."
