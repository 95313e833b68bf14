"""The numbers of a population as tables: a row a scene, a method, or an attribute."""

from __future__ import annotations

import numpy as np
import pandas as pd

from .failure_map import FailureMap
from .population import Population


def scenes_table(found: Population) -> pd.DataFrame:
    """A row a scene: its part, its attributes, each method's scores, and what is enough for it."""
    table = found.attributes.copy()
    table.insert(0, "part", found.parts)
    for metric, values in found.scores.items():
        for method in values.columns:
            table[f"{metric}: {method}"] = values[method]
    table[f"margin: {found.subject}"] = found.margins(found.subject)
    enough = {scene: found.enough(scene) for scene in found.psnr.index}
    table["first variant that is enough"] = pd.Series({scene: pair[0] for scene, pair in enough.items()}, dtype=object)
    table["smallest that is enough"] = pd.Series({scene: pair[1] for scene, pair in enough.items()}, dtype=object)
    return table.rename_axis("scene").reset_index()


def standings_table(found: Population) -> pd.DataFrame:
    """A row a method and part of the scenes."""
    rows = []
    for part in ["", *found.used_parts]:
        for method in found.psnr.columns:
            one = found.standing(method, part)
            low, high = one.margin_interval or (np.nan, np.nan)
            rows.append(
                {
                    "part": part or "all",
                    "method": method,
                    "scenes": one.scenes,
                    "best": one.best,
                    "best_low": one.best_share.low,
                    "best_high": one.best_share.high,
                    "margin_db": one.margin,
                    "margin_low": low,
                    "margin_high": high,
                    "level_share": one.level,
                    "worst_db": one.worst,
                    "failed": one.failed,
                }
            )
    return pd.DataFrame(rows)


def attributes_table(found: Population, mapped: FailureMap) -> pd.DataFrame:
    """A row an attribute: its quartiles over the scenes, and how the subject's margin goes with it."""
    quartiles = found.attributes.loc[found.psnr.index].quantile([0.25, 0.5, 0.75]).T
    quartiles.columns = ["lower_quartile", "median", "upper_quartile"]
    quartiles["rank_correlation"] = mapped.ranks
    order = quartiles["rank_correlation"].abs().sort_values(ascending=False).index
    return quartiles.loc[order].rename_axis("attribute").reset_index()
