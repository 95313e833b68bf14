"""A population in sentences: where methods win and lose, what scenes need, and what choosing has flattered."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from ...numbers.intervals import Interval
from .failure_map import FailureMap, failure_map, leaves, sentences, signs_told
from .population import LEVEL_DB, Population, Standing

OTHER = "the best other method"


def map_of(found: Population) -> FailureMap:
    """Of the subject's margin."""
    margins = found.margins(found.subject)
    return failure_map(found.attributes.loc[margins.index], margins)


def where(found: Population, mapped: FailureMap) -> list[str]:
    """One a leaf, and how well the tree holds on scenes that it has not seen."""
    said = list(sentences(mapped.tree, found.subject, OTHER, LEVEL_DB))
    held = (
        f"On scenes that it has not seen, the tree tells who is ahead on {100 * mapped.signs:.0f} %; to name the more "
        f"frequent winner each time is right on {100 * mapped.majority:.0f} %."
    )
    said += [held, f"It explains {100 * max(mapped.explained, 0):.0f} % of the difference's variance."]
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
    pairs = {scene: found.enough(scene) for scene in found.psnr.index}
    said = []
    ladder = found.ladder if len(found.ladder) > 1 else ()
    for method in ladder:
        share = np.mean([pair[0] == method for pair in pairs.values()])
        said.append(f"{method} is the first variant that is enough on {100 * share:.0f} % of the scenes.")
    for method in found.psnr.columns:
        share = np.mean([pair[1] == method for pair in pairs.values()])
        if share:
            said.append(f"{method} is the smallest model that is enough on {100 * share:.0f} % of the scenes.")
    attributes = found.attributes.loc[found.psnr.index]
    if ladder:
        gain = found.psnr[ladder[-1]] - found.psnr[ladder[0]]
        said += sentences(failure_map(attributes, gain).tree, ladder[-1], ladder[0], LEVEL_DB)
    sizes = pd.Series({scene: found.scores["primitives"].loc[scene, pair[1]] for scene, pair in pairs.items()})
    return said + list(_sizes(attributes, sizes))


def _sizes(attributes: pd.DataFrame, sizes: pd.Series) -> Iterator[str]:
    """How many primitives are enough, by what scenes are like; sizes differ by factors."""
    if sizes.isna().any():
        return
    for leaf, like in leaves(failure_map(attributes, np.log(sizes)).tree):
        count = f"{float(f'{np.exp(leaf.mean):.2g}'):,.0f}"
        yield f"{f'Where {like}: ' if like else ''}{count} primitives are enough ({leaf.scenes} scenes)."


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
