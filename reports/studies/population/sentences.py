"""A population in sentences: where methods win and lose, what scenes need, and what choosing has flattered."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from ...numbers.intervals import Interval
from .failure_map import FailureMap, Node, failure_map, leaves, sentences, signs_told
from .population import LEVEL_DB, Population, Standing

OTHER = "the best other method"


def map_of(found: Population) -> FailureMap:
    """Of the subject's margin."""
    margins = found.margins(found.subject)
    return failure_map(found.attributes.loc[margins.index], margins)


def where(found: Population, mapped: FailureMap) -> list[str]:
    """One a leaf, and how well the tree holds on scenes that it has not seen."""
    return [*sentences(mapped.tree, found.subject, OTHER, LEVEL_DB), *worth(found, mapped)]


def worth(found: Population, mapped: FailureMap) -> list[str]:
    """How well the tree holds on scenes that it has not seen."""
    said = [f"On scenes that it has not seen, the tree tells who is ahead on {100 * mapped.signs:.0f} %."]
    said.append(f"To name the more frequent winner each time is right on {100 * mapped.majority:.0f} %.")
    said.append(f"The tree explains {100 * max(mapped.explained, 0):.0f} % of the difference's variance.")
    if len(found.used_parts) == 2:
        margins = {part: found.margins(found.subject, part) for part in found.used_parts}
        grown = failure_map(found.attributes.loc[margins["choosing"].index], margins["choosing"])
        share = signs_told(grown, found.attributes.loc[margins["judging"].index], margins["judging"])
        said.append(f"Grown on the scenes for choosing, it tells who is ahead on {100 * share:.0f} % of the others.")
    return said


def gaps(found: Population) -> list[str]:
    """What choosing on the scenes for choosing has flattered."""
    pairs = ((method, found.gap(method)) for method in found.psnr.columns)
    return [
        f"{method}: {gap[0]:+.2f} dB{between(gap[1])} better on scenes for choosing than on those for judging."
        for method, gap in pairs
        if gap is not None
    ]


def needs(found: Population) -> list[str]:
    """On which scenes each variant of the ladder is the first that is enough, and how many primitives are."""
    said = shares(found)
    if tree := gains(found):
        said += sentences(tree, found.ladder[-1], found.ladder[0], LEVEL_DB)
    for where, count, scenes in sizes(found):
        said.append(f"{f'Where {where}: ' if where else ''}{count} primitives are enough ({scenes} scenes).")
    return said


def shares(found: Population) -> list[str]:
    """How often each variant of the ladder is the first that is enough, and each method the smallest."""
    pairs = [found.enough(scene) for scene in found.psnr.index]
    said = []
    for method in found.ladder if len(found.ladder) > 1 else ():
        share = np.mean([pair[0] == method for pair in pairs])
        said.append(f"{method} is the first variant that is enough on {100 * share:.0f} % of the scenes.")
    for method in found.psnr.columns:
        share = np.mean([pair[1] == method for pair in pairs])
        if share:
            said.append(f"{method} is the smallest model that is enough on {100 * share:.0f} % of the scenes.")
    return said


def gains(found: Population) -> Node | None:
    """The tree of the ladder's last variant less its first; None where there is no ladder."""
    if len(found.ladder) < 2:
        return None
    gain = found.psnr[found.ladder[-1]] - found.psnr[found.ladder[0]]
    return failure_map(found.attributes.loc[gain.index], gain).tree


def sizes(found: Population) -> list[tuple[str, str, int]]:
    """What scenes are like, how many primitives are enough there, and how many these scenes are.

    Sizes differ by factors: the tree is of their logarithms.
    """
    enough = pd.Series({s: found.scores["primitives"].loc[s, found.enough(s)[1]] for s in found.psnr.index})
    if enough.isna().any():
        return []
    tree = failure_map(found.attributes.loc[enough.index], enough.map(math.log)).tree
    return [(like, f"{float(f'{np.exp(leaf.mean):.2g}'):,.0f}", leaf.scenes) for leaf, like in leaves(tree)]


def shown(one: Standing) -> dict[str, str]:
    """A method's standing as tables print it."""
    low, high = one.best_share
    return {
        "method": one.method,
        "best": f"{100 * one.best / one.scenes:.0f} % ({100 * low:.0f} to {100 * high:.0f})",
        "margin": f"{one.margin:+.2f}{between(one.margin_interval)}",
        "level": f"{100 * one.level:.0f} %",
        "worst": f"{one.worst:+.2f}",
        "failed": str(one.failed),
    }


def between(interval: Interval | None) -> str:
    return "" if interval is None else f" ({interval[0]:+.2f} to {interval[1]:+.2f})"
