"""One colour and one mark a method, the same in every chart; told apart without colours too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    color: str
    marker: str  # matplotlib's
    symbol: str  # plotly's


# After Okabe and Ito for the ladder, then Tol's muted ones: safe for every common colour blindness.
LADDER = {
    "3dgs": Style("#0072B2", "s", "square"),
    "2dgs": Style("#009E73", "D", "diamond"),
    "envmap": Style("#DB8A00", "^", "triangle-up"),
    "envmap128": Style("#DB8A00", "^", "triangle-up"),
    "envmap256": Style("#8F5B00", ">", "triangle-right"),
    "envgs": Style("#D1495B", "o", "circle"),
}
COLORS = ("#332288", "#117733", "#AA4499", "#999933", "#882255", "#44AA99", "#CC6677")
MARKS = (("v", "triangle-down"), ("P", "cross"), ("X", "x"), ("p", "pentagon"), ("h", "hexagon"), ("*", "star"))


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """A style for each of the methods, by name for the ladder's, in turn for the others."""
    chosen: dict[str, Style] = {}
    others = 0
    for method in methods:
        if method in LADDER:
            chosen[method] = LADDER[method]
        else:
            marker, symbol = MARKS[others % len(MARKS)]
            chosen[method] = Style(COLORS[others % len(COLORS)], marker, symbol)
            others += 1
    return chosen
