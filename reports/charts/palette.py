"""One color and one mark a method, the same in every chart; told apart without colors too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Style:
    color: str
    marker: str  # matplotlib's
    symbol: str  # plotly's


# After Okabe and Ito for the paper's methods, lighter for their tuned variants, then Tol's muted ones: safe for every
# common color blindness.
METHOD_STYLES = {
    "3dgs": Style("#0072B2", "s", "square"),
    "3dgs_tuned": Style("#56B4E9", "8", "octagon"),
    "2dgs": Style("#009E73", "D", "diamond"),
    "2dgs_tuned": Style("#5CC9A7", "H", "hexagon2"),
    "envmap_paper": Style("#B35900", "<", "triangle-left"),
    "envmap": Style("#DB8A00", "^", "triangle-up"),
    "envmap128": Style("#DB8A00", "^", "triangle-up"),
    "envmap256": Style("#8F5B00", ">", "triangle-right"),
    "envgs_paper": Style("#8C1C38", "d", "diamond-tall"),
    "envgs_no_joint": Style("#CC79A7", "p", "pentagon"),
    "envgs": Style("#D1495B", "o", "circle"),
}
COLORS = ("#6A5ACD", "#2A8F4E", "#AA4499", "#8C8C1F", "#A3386F", "#2F9C8F", "#CC6677")
MARKS = (("v", "triangle-down"), ("P", "cross"), ("X", "x"), ("h", "hexagon"), ("*", "star"))


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """A style for each of the methods, METHOD_STYLES by name, the others in turn.

    Variants of one method (`envgs [steps=9]`) share its color, each lighter than the one before, and its mark.
    """
    chosen: dict[str, Style] = {}
    families: dict[str, list[str]] = {}
    for method in methods:
        families.setdefault(method.split(" [")[0], []).append(method)
    others = 0
    for name, members in families.items():
        if name in METHOD_STYLES:
            style = METHOD_STYLES[name]
        else:
            marker, symbol = MARKS[others % len(MARKS)]
            style = Style(COLORS[others % len(COLORS)], marker, symbol)
            others += 1
        for index, method in enumerate(members):
            chosen[method] = replace(style, color=_lighter(style.color, 0.55 * index / len(members)))
    return chosen


def _lighter(color: str, share: float) -> str:
    """#rrggbb moved toward white by `share` in [0, 1]."""
    parts = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(part + (255 - part) * share):02X}" for part in parts)
