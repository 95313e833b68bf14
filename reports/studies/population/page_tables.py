"""What the documentation's pages show of a population, from kept runs."""

from __future__ import annotations

import pandas as pd

from ...kept.csv_file import NoRunsError
from ...kept.kept_runs import KeptRuns, TableError
from ...kept.runs_file import ATTRIBUTE
from ...kept.tables import as_markdown
from .failure_map import FailureMap, Node, leaves
from .goals import goals, told
from .population import FEWEST_SCENES, LEVEL_DB, METRICS, PARTS, Population, part_of
from .sentences import gains, gaps, map_of, shares, shown, sizes, worth


def goals_told(runs: KeptRuns, of: str) -> str:
    """What is missed, then what is reached."""
    found = population_in(runs, of)
    return _list(told(goals(found, map_of(found))), runs)


def standings(runs: KeptRuns, of: str) -> str:
    """A row a method, of each part of the scenes."""
    found = population_in(runs, of)
    heads = ["method", "best on", "less the best other, dB", f"level ({LEVEL_DB:g} dB) or ahead on", "worst", "failed"]
    tables = []
    for part in found.used_parts or [""]:
        rows = [list(shown(found.standing(method, part)).values()) for method in found.psnr.columns]
        count = f"{len(found.scenes(part))} scenes" + (f" for {part}, {PARTS[part]}" if part else "")
        tables.append(f"{count}:\n\n{as_markdown(heads, rows)}")
    what = "PSNR; a scene counts once. Brackets are 95 % intervals over scenes"
    return "\n".join([*tables, runs.caption(what), ""])


def failure_map_told(runs: KeptRuns, of: str) -> str:
    """The tree, how well it holds, and the attributes that go with the margin most."""
    found = population_in(runs, of)
    mapped = map_of(found)
    tree = _tree(mapped.tree, f"{of} less the best other, dB")
    return "\n".join([tree, _list(worth(found, mapped), runs), _ranks(found, mapped)])


def needs_told(runs: KeptRuns, of: str, ladder: str) -> str:
    """What is enough for a scene; `ladder` names the variants from the baseline up, `a,b,c`."""
    found = population_in(runs, of, tuple(ladder.split(",")))
    tables = [as_markdown(["where", "primitives that are enough", "scenes"], _in_words(sizes(found)))]
    if tree := gains(found):
        tables.insert(0, _tree(tree, f"{found.ladder[-1]} less {found.ladder[0]}, dB"))
    return "\n".join([*tables, _list(shares(found), runs)])


def gaps_told(runs: KeptRuns, of: str) -> str:
    """By how much scores on the scenes for choosing flatter."""
    found = population_in(runs, of)
    said = gaps(found)
    if not said:
        raise NoRunsError(f"{runs.name} has fewer than {FEWEST_SCENES} scenes of one part")
    return _list(said, runs)


def population_in(runs: KeptRuns, of: str, ladder: tuple[str, ...] = ()) -> Population:
    """The population of kept runs.

    Raises:
        NoRunsError: too few scenes with attributes that all methods finished.
        TableError: a method has no runs.
    """
    absent = [method for method in (of, *ladder) if method not in runs.methods]
    if absent:
        raise TableError(f"{runs.name} has no method {absent[0]!r} here, but {', '.join(runs.methods)}")
    named = [name for name in runs.rows.columns if name.startswith(ATTRIBUTE)]
    known = runs.rows.dropna(subset=named, how="all") if named else runs.rows.iloc[:0]
    attributes = known.groupby("scene")[named].first().dropna(axis=1)
    attributes.columns = [name.removeprefix(ATTRIBUTE) for name in attributes.columns]
    rows = runs.rows[runs.rows["scene"].isin(attributes.index)]
    done = rows[rows["status"] == "ok"]
    scores = {
        metric: done.pivot_table(index="scene", columns="method", values=metric, aggfunc="mean").reindex(
            columns=list(runs.methods)
        )
        for metric in METRICS
        if metric in done
    }
    parts = pd.Series({scene: part_of(int(scene.rpartition("/")[2])) for scene in attributes.index})
    failures = {str(method): int((own["status"] != "ok").sum()) for method, own in rows.groupby("method")}
    found = Population(attributes, parts, scores, failures, of, ladder)
    if not scores or len(found.psnr) < FEWEST_SCENES:
        raise NoRunsError(f"{runs.name} has fewer than {FEWEST_SCENES} scenes that all methods finished")
    return found


def _tree(tree: Node, what: str) -> str:
    """A row a leaf."""
    rows = [(like, f"{leaf.mean:+.1f}", leaf.scenes) for leaf, like in leaves(tree)]
    return as_markdown(["where", what, "scenes"], _in_words(rows))


def _in_words(rows: list[tuple[str, str, int]]) -> list[list[str]]:
    return [[like or "everywhere", number, str(scenes)] for like, number, scenes in rows]


def _ranks(found: Population, mapped: FailureMap) -> str:
    quartiles = found.attributes.loc[found.psnr.index].quantile([0.25, 0.5, 0.75])
    rows = [
        [str(name).replace("_", " "), f"{rank:+.2f}", *(f"{value:.3g}" for value in quartiles[name])]
        for name, rank in mapped.ranks.items()
    ]
    return as_markdown(["attribute", "rank correlation", "lower quartile", "median", "upper quartile"], rows)


def _list(sentences: list[str], runs: KeptRuns) -> str:
    return "".join(f"* {sentence}\n" for sentence in sentences) + f"\n{runs.caption('PSNR')}\n"
