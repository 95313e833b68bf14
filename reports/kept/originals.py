"""Published methods beside their authors' code, from a CSV of marks that both left at the same steps of their runs.

A mark without a score says that the method has an original that was not run. What differs between the two is said by a
second CSV, a row a method: its original's repository and commit, the page of its rules, and the difference in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from .csv_file import NoRunsError

CLOSE_DB, CLOSE_SHARE = 0.3, 0.1
NOT_RUN, SO_FAR = "not run", "so far"
SETTLED = 7_000  # steps from which on two curves that agree have a verdict
FACTS = ("method", "scene", "program", "commit", "seed", "run", "steps", "psnr", "primitives", "seconds", "device")
ALONE = ("step_ms", "frame_ms")  # timed while nothing else computed on the GPU
WORDS = ("method", "repository", "commit", "page", "differs")
ORIGINAL, OURS = "original", "ours"


class MarksError(ValueError):
    """A CSV of marks, or of what differs, that cannot be used; the message names the file and what it lacks."""


@dataclass(frozen=True)
class Pair:
    """Both programs' marks of a scene at the last step that both have; several rows are several seeds or runs."""

    method: str
    scene: str
    original: pd.DataFrame
    ours: pd.DataFrame

    @property
    def steps(self) -> int:
        return int(self.ours["steps"].iloc[0])

    @property
    def gain(self) -> float:
        """Ours less the original's, dB of test PSNR."""
        return float(self.ours["psnr"].mean() - self.original["psnr"].mean())

    @property
    def share(self) -> float:
        """Our primitives more than the original's, as a share of these."""
        return float(self.ours["primitives"].mean() / self.original["primitives"].mean() - 1)

    @property
    def apart(self) -> list[str]:
        """What is farther from the original than the bounds, or than its own seeds are from each other."""
        spread = self.original[["psnr", "primitives"]].max() - self.original[["psnr", "primitives"]].min()
        near_db = max(CLOSE_DB, spread["psnr"])
        near_share = max(CLOSE_SHARE, spread["primitives"] / self.original["primitives"].mean())
        found = {"dB": abs(self.gain) > near_db, "primitives": abs(self.share) > near_share}
        return [name for name, far in found.items() if far]

    @property
    def verdict(self) -> str:
        if self.apart:
            return f"no: {', '.join(self.apart)}"
        return "yes" if self.steps >= SETTLED else SO_FAR


def read_marks(path: Path) -> pd.DataFrame:
    """The marks, a row each. Raises MarksError where the file or a column is missing."""
    return _read(path, (*FACTS, *ALONE))


def read_words(path: Path) -> pd.DataFrame:
    """What differs, a row a method. Raises MarksError where the file or a column is missing."""
    return _read(path, WORDS).fillna("")


def pairs_of(marks: pd.DataFrame) -> Iterator[Pair]:
    """Each scene of a method that both programs ran."""
    scored = marks.dropna(subset=["psnr"])
    for (method, scene), rows in scored.groupby(["method", "scene"], sort=True):
        sides = {program: rows[rows["program"] == program] for program in (ORIGINAL, OURS)}
        common = set(sides[ORIGINAL]["steps"]) & set(sides[OURS]["steps"])
        if common:
            last = {program: side[side["steps"] == max(common)] for program, side in sides.items()}
            yield Pair(str(method), str(scene), last[ORIGINAL], last[OURS])


def verdicts(marks: pd.DataFrame, words: pd.DataFrame) -> str:
    """A row a method: scenes, the fewest steps of one, the verdict, how far apart they are at most."""
    pairs = list(pairs_of(marks))
    rows = []
    for _, word in words.iterrows():
        own = [pair for pair in pairs if pair.method == word["method"]]
        commit = f"[{word['repository']}](https://github.com/{word['repository']}) `{word['commit']}`"
        cells = [_linked(word), commit if word["commit"] else "–", str(len(own))]
        rows.append([*cells, *_summary(own)])
    return _table(["method", "original", "scenes", "steps", "faithful?", "farthest"], "::--::", rows)


def what_differs(marks: pd.DataFrame, words: pd.DataFrame) -> str:
    """A row a method of which something is known to differ, whether it has marks or not."""
    rows = [[_linked(word), word["differs"]] for _, word in words.iterrows() if word["differs"]]
    return _table(["method", "what differs, and why"], "::", rows)


def _summary(pairs: list[Pair]) -> list[str]:
    """Of a method's scenes: the fewest steps of one, the verdict, and the farthest difference of scores and sizes."""
    if not pairs:
        return ["–", NOT_RUN, "–"]
    close = [pair for pair in pairs if not pair.apart]
    verdict = "no" if not close else f"on {len(close)}" if len(close) < len(pairs) else "yes"
    if verdict == "yes" and any(pair.steps < SETTLED for pair in pairs):
        verdict = SO_FAR
    gain, share = (max(values, key=abs) for values in zip(*((pair.gain, pair.share) for pair in pairs), strict=True))
    farthest = f"{gain:+.2f} dB, {share:+.0%}".replace("-", "−")
    return [f"{min(pair.steps for pair in pairs):,}", verdict, farthest]


def comparisons(marks: pd.DataFrame, words: pd.DataFrame) -> str:
    """A row a scene of a method: both scores, primitives and seconds at the last mark that both have."""
    pages = {word["method"]: word for _, word in words.iterrows()}
    rows = [
        [
            _linked(pages[pair.method]),
            f"`{pair.scene}`",
            f"{pair.steps:,}",
            pair.verdict,
            *(_spread(side["psnr"], 2) for side in (pair.original, pair.ours)),
            *(f"{side['primitives'].mean():,.0f}" for side in (pair.original, pair.ours)),
            *(_seconds(side["seconds"].mean()) for side in (pair.original, pair.ours)),
        ]
        for pair in pairs_of(marks)
    ]
    sides = [f"{side}, {what}" for what in ("dB", "primitives", "s") for side in (ORIGINAL, OURS)]
    return _table(["method", "scene", "steps", "faithful?", *sides], "::-:" + "-" * 6, rows)


def costs_alone(marks: pd.DataFrame, words: pd.DataFrame) -> str:
    """A row a scene of a method: a step of training and a frame, each timed while nothing else computed on the GPU.

    Raises:
        NoRunsError: none was.
    """
    pages = {word["method"]: word for _, word in words.iterrows()}
    rows = []
    for pair in pairs_of(marks.dropna(subset=list(ALONE))):
        cells = [_linked(pages[pair.method]), f"`{pair.scene}`", f"{pair.steps:,}"]
        cells += [f"{side['primitives'].mean():,.0f}" for side in (pair.original, pair.ours)]
        for name in ALONE:
            theirs, own = pair.original[name].mean(), pair.ours[name].mean()
            cells += [f"{theirs:.2f}", f"{own:.2f}", f"{theirs / own:.1f}×"]
        rows.append(cells)
    if not rows:
        raise NoRunsError("no method was timed alone on a GPU beside its original")
    sides = [f"primitives, {side}" for side in (ORIGINAL, OURS)]
    sides += [f"{what}, {side}" for what in ("step, ms", "frame, ms") for side in (ORIGINAL, OURS, "ratio")]
    return _table(["method", "scene", "steps", *sides], "::" + "-" * 9, rows)


BESIDE_ORIGINALS = {
    "verdicts": verdicts,
    "what_differs": what_differs,
    "comparisons": comparisons,
    "costs_alone": costs_alone,
}


def _read(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    try:
        rows = pd.read_csv(path, dtype={"commit": str})
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise MarksError(f"{path}: cannot be read: {error}") from error
    if absent := [name for name in columns if name not in rows]:
        raise MarksError(f"{path}: expected a CSV with the columns {', '.join(columns)}; it has no {absent[0]}")
    return rows


def _linked(word: pd.Series) -> str:
    return f"[`{word['method']}`]({word['page']})"


def _seconds(mean: float) -> str:
    """A dash where two programs did not train in equal company."""
    return "–" if math.isnan(mean) else f"{mean:.0f}"


def _spread(values: pd.Series, digits: int) -> str:
    """The mean, with the standard deviation over seeds where there are several."""
    mean = f"{values.mean():.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {values.std():.{digits}f}"


def _table(heads: list[str], sides: str, rows: list[list[str]]) -> str:
    rule = [{":": ":--", "-": "--:"}[side] for side in sides.ljust(len(heads), ":")]
    return "".join(f"| {' | '.join(line)} |\n" for line in (heads, rule, *rows))
