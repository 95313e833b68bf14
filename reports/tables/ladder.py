"""Tables of ladders: a row a rung, what it adds to the one below, what it costs, and how it stands to the best."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from ..numbers.estimates import Estimate
from ..numbers.ladder import PSNR, SAME_FRAME_TIME, Criterion, Ladder, Rung, Verdict
from ..numbers.statistics import FEWEST_SEEDS
from .columns import COSTS, ENV_PRIMITIVES, LPIPS, PRIMITIVES, REGIONS, SCORES, Column, in_region
from .columns import PSNR as WHOLE
from .recommendations import recommendation
from .table import Cell, Row, Table, with_numbers

KIND = "ladder"
BELOW, BEST = "the rung below", "the best"  # what is subtracted where a column is a difference
WORDS: dict[Verdict, str] = {
    "best": "best PSNR",
    "within": "as good as the best",
    "tied": "tied with the best",
    "behind": "behind the best",
    "undecided": "too few seeds",
    "failed": "some run did not finish",
}
TAKE = "take"
SCORED_REGIONS = tuple(name for name in REGIONS if name in ("reflective", "near_field"))


def ladder_columns(ladder: Ladder) -> tuple[Column, ...]:
    """Groups of columns: the scores with what they gain, the differences to the best, the costs."""
    columns: list[Column] = []
    for column, group in ((WHOLE, "whole picture"), *((in_region(WHOLE, r), _named(r)) for r in SCORED_REGIONS)):
        score = replace(column, title=WHOLE.title, group=group, ranked=False)
        columns += [score, _difference(score, BELOW)]
    perceptual = [score for score in SCORES if score in (LPIPS, *map(_score, ladder.criteria[1:]))]
    columns += [replace(score, ranked=False) for score in reversed(perceptual)]
    columns += [_difference(replace(_score(c), group="against the best"), BEST) for c in ladder.criteria]
    columns += [replace(column, ranked=False) for column in COSTS if column != PRIMITIVES]
    sets = ((PRIMITIVES, "all"), (ENV_PRIMITIVES, "environment"))
    return (*columns, *(replace(column, title=title, group="primitives") for column, title in sets))


def _difference(column: Column, against: str) -> Column:
    title = f"Δ {column.title}"
    return replace(
        column, title=title, against=against, with_interval=True, ranked=False, explanation=f"minus {against}'s"
    )


def _score(criterion: Criterion) -> Column:
    return next(column for column in SCORES if column.metric == criterion.metric)


def _named(region: str) -> str:
    return region.replace("_", "-")


def ladder_table(ladder: Ladder) -> Table:
    """The ladder's rungs from the top down to the ground up, without columns that have no number."""
    columns = ladder_columns(ladder)
    rows = [_row(ladder, rung, columns) for rung in ladder.rungs]
    verdicts = "; ".join(
        f"{row.method} ({rung.part}): {row.verdict}" for rung, row in zip(ladder.rungs, rows, strict=True)
    )
    remarks = (recommendation(ladder).text, f"Rungs: {verdicts}.", *explanations(ladder))
    return Table(
        f"{ladder.title}: the ladder",
        KIND,
        with_numbers(columns, rows),
        tuple(rows),
        (ladder.dataset,),
        remarks=remarks,
    )


def _row(ladder: Ladder, rung: Rung, columns: tuple[Column, ...]) -> Row:
    taken = rung == ladder.recommended
    verdict = f"{TAKE}: {WORDS[ladder.verdict(rung)]}" if taken else WORDS[ladder.verdict(rung)]
    cells = {column.key: Cell(column, _estimate(ladder, rung, column)) for column in columns}
    statuses = ladder.numbers.statuses((ladder.dataset,), rung.method)
    return Row(rung.method, cells, Counter(statuses), verdict=verdict, taken=taken)


def _estimate(ladder: Ladder, rung: Rung, column: Column) -> Estimate:
    if not column.against:
        return ladder.value(rung, column.metric, column.region)
    other = ladder.below(rung) if column.against == BELOW else ladder.best
    return Estimate() if other == rung else ladder.difference(rung, other, column.metric, column.region)


def explanations(ladder: Ladder) -> list[str]:
    """What the numbers of a ladder's table are, and by which rule a rung is taken."""
    bounds = " and ".join(f"{c.tolerance:g} {_score(c).title if c != PSNR else 'dB'}" for c in ladder.criteria)
    found = [
        "Δ: the mean over seeds of the difference on the same seed, with its 95 % bootstrap interval; to the rung "
        "below, or to the best, which is the rung with the highest mean PSNR.",
        f"Taken is the rung with the shortest frame time (within {SAME_FRAME_TIME:.0%} of it: with the fewest "
        f"primitives) among those that no such interval shows to be worse than the best by more than {bounds}. A rung "
        f"of which some run did not finish, or that has fewer than {FEWEST_SEEDS} seeds, is not taken.",
    ]
    if ladder.passed_over:
        found.append(f"Of rows of one rung, that with the most runs. Left out: {', '.join(ladder.passed_over)}.")
    return found
