"""How often diagnosis is right, from a CSV of `envgs-bench diagnose`: false alarms of scenes in order, and recall.

A row of the file is a scene, in order or spoiled in one way: `warned` has the warnings it was given and `repaired` the
repairs that were right, each a list of words.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import pandas as pd

from envgs_bench.records import RepairKind, WarningKind

from .csv_file import read_rows
from .tables import NOTHING, as_markdown

KINDS = get_args(WarningKind)
OF_SCENES = KINDS[KINDS.index("views_sparse") :]  # the warnings of a scene that is trained on for long enough
REPAIRS = get_args(RepairKind)
ANSWERS: dict[str, tuple[str, ...]] = {  # what is spoiled -> the warning and the repair that say so
    "exposure": ("warning exposures_differ", "repair exposures"),
    "pose_rotation": ("warning poses_off", "repair poses"),
    "normals_mirrored": ("warning normals_mirrored", "repair normals"),
}
ONLY_WHERE = dict.fromkeys(("warning normals_mirrored", "repair normals"), "mirror_gain")  # this was measured
CONFIDENCE = 0.95
FACTS = ("seed", "width", "height", "views", "spoiled", "severity", "warned", "repaired")


class CountsError(ValueError):
    """A CSV of counts that cannot be used; the message names the file and what is wrong with it."""


def read_counts(path: Path) -> pd.DataFrame:
    """The rows of a file that `envgs-bench diagnose` wrote.

    Raises:
        NoRunsError: there is no such file.
        CountsError: it is another.
    """
    command = f"envgs-bench diagnose --seeds 1000-1063 --out {path}"
    return read_rows(path, FACTS, CountsError, "counts", command)


@dataclass(frozen=True)
class Rate:
    """A question, and of how many scenes the answer was yes.

    Attributes:
        spoiled, severity: what the scenes are; "" and 0 in order.
        asked: "warning <kind>", "repair <kind>", or "any warning".
        found, scenes: of how many, of all that were asked.
        bound: what this leaves possible, the end of the one-sided interval of Clopper and Pearson at 95 %. Of scenes in
            order it is the largest share of false alarms, of spoiled ones the smallest share that is found.
    """

    spoiled: str
    severity: int
    asked: str
    found: int
    scenes: int
    bound: float


def rates(rows: pd.DataFrame) -> list[Rate]:
    """Those of every question, scenes in order first."""
    from scipy.stats import binomtest  # takes a second to import

    found = []
    for spoiled, severity in sorted(set(zip(rows["spoiled"], rows["severity"], strict=True))):
        asked_of = rows[(rows["spoiled"] == spoiled) & (rows["severity"] == severity)]
        for asked, answers in _answers(asked_of, spoiled):
            if answers.empty:
                continue
            hits, scenes = int(answers.sum()), len(answers)
            tested = binomtest(hits, scenes, alternative="greater" if spoiled else "less").proportion_ci(CONFIDENCE)
            bound = float(tested.low if spoiled else tested.high)
            found.append(Rate(spoiled, int(severity), asked, hits, scenes, bound))
    return found


def _answers(rows: pd.DataFrame, spoiled: str) -> Iterator[tuple[str, pd.Series[bool]]]:
    """Each question that is asked of these rows, and what the answers are."""
    said = {"warning": rows["warned"].str.split().map(set), "repair": rows["repaired"].str.split().map(set)}
    in_order = (*(f"warning {kind}" for kind in OF_SCENES), *(f"repair {kind}" for kind in REPAIRS))
    for asked in ANSWERS[spoiled] if spoiled else in_order:
        what, kind = asked.split()
        answers = said[what].map(lambda words, kind=kind: kind in words)
        measured = rows.get(ONLY_WHERE.get(asked, ""))
        yield asked, answers if measured is None else answers[measured != ""]
    if not spoiled:
        yield "any warning", said["warning"].map(bool)


def false_alarms(rows: pd.DataFrame, name: str) -> str:
    """A row a question asked of scenes in order: how many were warned of, or changed, at each size and at all."""
    return _table(rows[rows["spoiled"] == ""], name, "at most", "in order")


def found(rows: pd.DataFrame, name: str) -> str:
    """A row a question asked of scenes spoiled on purpose: how many it found, at each size and at all."""
    return _table(rows[rows["spoiled"] != ""], name, "at least", "spoiled")


def _table(rows: pd.DataFrame, name: str, bound: str, which: str) -> str:
    sizes = sorted(set(zip(rows["width"], rows["height"], strict=True)))
    parts = [rates(rows[(rows["width"] == width) & (rows["height"] == height)]) for width, height in sizes]
    counts = [{_question(rate): f"{rate.found} of {rate.scenes}" for rate in part} for part in parts]
    lines = []
    for rate in rates(rows):
        cells = (part.get(_question(rate), NOTHING) for part in counts)
        lines.append([_question(rate), *cells, f"{rate.found} of {rate.scenes}", f"{100 * rate.bound:.1f} %"])
    heads = [which, *(f"{width}×{height}" for width, height in sizes), "all", bound]
    scenes = rows.drop_duplicates(["seed", "width"])
    caption = f"*{len(scenes)} sampled scenes, one-sided bounds at 95 %. Source: `{name}`.*"
    return f"{as_markdown(heads, lines)}\n{caption}\n"


def _question(rate: Rate) -> str:
    what, _, kind = rate.asked.partition(" ")
    asked = {"warning": f"`{kind}`", "repair": f"`repair={kind}`"}.get(what, rate.asked)
    return f"`{rate.spoiled}` {rate.severity}: {asked}" if rate.spoiled else asked
