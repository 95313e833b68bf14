"""Tables of ablation ladders: a row a variant, what it adds to the one before, what it costs, how it stands."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from ...numbers.comparison import FEWEST_SEEDS
from ...numbers.estimates import Estimate
from ...tables.columns import COSTS, ENV_PRIMITIVES, LPIPS, PRIMITIVES, REGIONS, SCORES, Column, in_region
from ...tables.columns import PSNR as WHOLE
from ...tables.table import Cell, Row, Table, with_numbers
from .ladder import PSNR, SAME_FRAME_TIME, Criterion, Ladder, Variant, Verdict
from .recommendation import recommendation

KIND = "ablation-ladder"
BEFORE, BEST = "the variant before", "the best"  # what is subtracted where a column is a difference
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
        columns += [score, _difference(score, BEFORE)]
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
    """The ladder's variants from the baseline up, without columns that have no number."""
    columns = ladder_columns(ladder)
    rows = [_row(ladder, variant, columns) for variant in ladder.variants]
    verdicts = "; ".join(
        f"{row.method} ({variant.part}): {row.verdict}" for variant, row in zip(ladder.variants, rows, strict=True)
    )
    remarks = (recommendation(ladder).text, f"Variants: {verdicts}.", *explanations(ladder))
    return Table(
        f"{ladder.title}: ablation ladder",
        KIND,
        with_numbers(columns, rows),
        tuple(rows),
        (ladder.dataset,),
        remarks=remarks,
    )


def _row(ladder: Ladder, variant: Variant, columns: tuple[Column, ...]) -> Row:
    taken = variant == ladder.recommended
    verdict = f"{TAKE}: {WORDS[ladder.verdict(variant)]}" if taken else WORDS[ladder.verdict(variant)]
    cells = {column.key: Cell(column, _estimate(ladder, variant, column)) for column in columns}
    statuses = ladder.numbers.statuses((ladder.dataset,), variant.method)
    return Row(variant.method, cells, Counter(statuses), verdict=verdict, taken=taken)


def _estimate(ladder: Ladder, variant: Variant, column: Column) -> Estimate:
    if not column.against:
        return ladder.value(variant, column.metric, column.region)
    other = ladder.before(variant) if column.against == BEFORE else ladder.best
    return Estimate() if other == variant else ladder.difference(variant, other, column.metric, column.region)


def explanations(ladder: Ladder) -> list[str]:
    """What the numbers of a ladder's table are, and by which rule a variant is taken."""
    bounds = " and ".join(f"{c.tolerance:g} {_score(c).title if c != PSNR else 'dB'}" for c in ladder.criteria)
    found = [
        "Δ: the mean over seeds of the difference on the same seed, with its 95 % interval; to the "
        "variant before, or to the best, which is the variant with the highest mean PSNR.",
        f"Taken is the variant with the shortest frame time (within {SAME_FRAME_TIME:.0%} of it: with the fewest "
        f"primitives) among those that no such interval shows to be worse than the best by more than {bounds}. A "
        f"variant of which some run did not finish, or that has fewer than {FEWEST_SEEDS} seeds, is not taken.",
    ]
    if ladder.passed_over:
        found.append(f"Of rows of one variant, that with the most runs. Left out: {', '.join(ladder.passed_over)}.")
    return found
