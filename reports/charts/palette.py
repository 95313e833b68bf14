"""One color and one mark a method, the same in every chart; told apart without colors too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Style:
    color: str
    marker: str  # matplotlib's
    symbol: str  # plotly's


def _toward(color: str, share: float) -> str:
    """#rrggbb moved toward white by `share` in [0, 1], toward black where it is below 0."""
    end = 255 if share > 0 else 0
    parts = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(part + (end - part) * abs(share)):02X}" for part in parts)


# One color a family of methods. Every two are at least 20 ΔE (CIEDE2000) apart for people with normal vision and those
# who lack red, green or blue cones (Machado et al. 2009); found by search under that condition.
FAMILIES = {
    "3dgs": "#336666",
    "2dgs": "#80E6B3",
    "envmap": "#FF9900",
    "envgs": "#CC0000",
    "3dgs_dr": "#8000E6",
    "gaussian_shader": "#B380FF",
    "3igs": "#FFCCFF",
    "ref_gaussian": "#331A66",
    "envgs_single_set": "#66001A",
    "renders": "#809999",
}
# method -> its family, matplotlib's mark, plotly's, and by how much it is lighter (darker where below 0)
METHODS = {
    "3dgs": ("3dgs", "s", "square", 0.35),
    "3dgs_tuned": ("3dgs", "8", "octagon", 0.0),
    "3dgs_lean": ("3dgs", "v", "triangle-down", -0.4),
    "2dgs": ("2dgs", "D", "diamond", -0.25),
    "2dgs_tuned": ("2dgs", "H", "hexagon2", 0.0),
    "2dgs_lean": ("2dgs", "v", "triangle-down", -0.5),
    "envmap_paper": ("envmap", "<", "triangle-left", -0.3),
    "envmap": ("envmap", "^", "triangle-up", 0.0),
    "envmap128": ("envmap", "^", "triangle-up", 0.0),
    "envmap256": ("envmap", ">", "triangle-right", -0.3),
    "envmap_4spp": ("envmap", "*", "star", -0.3),
    "envgs_paper": ("envgs", "d", "diamond-tall", 0.35),
    "envgs_no_joint": ("envgs", "p", "pentagon", 0.5),
    "envgs": ("envgs", "o", "circle", 0.0),
    "envgs_lean": ("envgs", "v", "triangle-down", -0.4),
    "envgs_4spp": ("envgs", "*", "star", -0.3),
    "3dgs_dr": ("3dgs_dr", "P", "cross", 0.0),
    "3dgs_dr_tuned": ("3dgs_dr", "v", "triangle-down", 0.0),
    "gaussian_shader": ("gaussian_shader", "X", "x", 0.0),
    "gaussian_shader_tuned": ("gaussian_shader", "v", "triangle-down", 0.0),
    "3igs": ("3igs", "*", "star", 0.0),
    "3igs_tuned": ("3igs", "v", "triangle-down", 0.0),
    "ref_gaussian": ("ref_gaussian", "h", "hexagon", 0.0),
    "ref_gaussian_tuned": ("ref_gaussian", "p", "pentagon", 0.0),
}
METHOD_STYLES = {
    name: Style(_toward(FAMILIES[family], share), marker, symbol)
    for name, (family, marker, symbol, share) in METHODS.items()
}
MARKS = (("v", "triangle-down"), ("P", "cross"), ("X", "x"), ("h", "hexagon"), ("*", "star"))


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """A style for each of the methods: METHOD_STYLES by name, the others in turn what no family here has.

    Variants of one method (`envgs [steps=9]`) share its color, each lighter than the one before, and its mark.
    """
    chosen: dict[str, Style] = {}
    families: dict[str, list[str]] = {}
    for method in methods:
        families.setdefault(method.split(" [")[0], []).append(method)
    taken = {METHODS[name][0] for name in families if name in METHODS}
    free = [color for family, color in reversed(FAMILIES.items()) if family not in taken] or list(FAMILIES.values())
    others = 0
    for name, members in families.items():
        if name in METHOD_STYLES:
            style = METHOD_STYLES[name]
        else:
            marker, symbol = MARKS[others % len(MARKS)]
            style = Style(free[others % len(free)], marker, symbol)
            others += 1
        for index, method in enumerate(members):
            chosen[method] = replace(style, color=_toward(style.color, 0.55 * index / len(members)))
    return chosen
