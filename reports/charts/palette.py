"""One color and one mark a method, the same in every chart; told apart without colors too."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from envgs_bench.parts import MethodCard


@dataclass(frozen=True)
class Style:
    color: str
    marker: str  # matplotlib's
    symbol: str  # plotly's


# For methods whose cards have no color. Every two are at least 20 ΔE (CIEDE2000) apart for people with normal vision
# and those who lack red, green or blue cones (Machado et al. 2009); found by search under that condition.
COLORS = ("#809999", "#66001A", "#331A66", "#FFCCFF", "#B380FF", "#8000E6", "#CC0000", "#FF9900", "#80E6B3", "#336666")
MARKS = (
    *(("o", "circle"), ("s", "square"), ("^", "triangle-up"), ("D", "diamond"), ("H", "hexagon2"), ("p", "pentagon")),
    *(("v", "triangle-down"), ("P", "cross"), ("X", "x"), ("h", "hexagon"), ("*", "star"), ("8", "octagon")),
    *(("<", "triangle-left"), (">", "triangle-right"), ("d", "diamond-tall")),
)


def toward(color: str, share: float) -> str:
    """#rrggbb moved toward white by `share` in [0, 1]."""
    parts = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(part + (255 - part) * share):02X}" for part in parts)


def styles(rows: Sequence[str], cards: Mapping[str, MethodCard]) -> dict[str, Style]:
    """A style for each of the rows: the color of its method's family, and a mark that no other method here has.

    Of methods of one color each is lighter than the one before, and so are variants of one method (`envgs [steps=9]`),
    which share its mark.

    Args:
        cards: of all methods that any chart shows, by name, in the tables' order: equal ones give equal styles.
    """
    names: dict[str, list[str]] = {name: [] for name in cards}
    for row in rows:
        names.setdefault(row.split(" [")[0], []).append(row)
    colors = _colors(names, {name: card.color for name, card in cards.items() if card.color})
    chosen = {}
    for number, (name, members) in enumerate(names.items()):
        for index, row in enumerate(members):
            color = toward(colors[name], 0.55 * index / len(members))
            chosen[row] = Style(color, *MARKS[number % len(MARKS)])
    return chosen


def _colors(names: Iterable[str], given: Mapping[str, str]) -> dict[str, str]:
    """The given color of each name, or one that is not given to any, by the name's hash; lighter where it is shared."""
    free = [color for color in COLORS if color not in given.values()] or list(COLORS)
    chosen = dict(given)
    for name in names:
        if name not in chosen:
            left = [color for color in free if color not in chosen.values()] or free
            chosen[name] = left[zlib.crc32(name.encode()) % len(left)]
    sharing: dict[str, list[str]] = {}
    for name, color in chosen.items():
        sharing.setdefault(color, []).append(name)
    return {n: toward(color, 0.5 * i / len(group)) for color, group in sharing.items() for i, n in enumerate(group)}
