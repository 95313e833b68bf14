"""Recommendation: which variant of a ladder a scene needs, what it costs and what is lost, in a sentence or two."""

from __future__ import annotations

from dataclasses import dataclass, replace

from envgs_bench.parts import ENV

from ...numbers.comparison import FEWEST_SEEDS
from ...tables.columns import FRAME_MS, MEGABYTES, PRIMITIVES, SCORES, TRAIN_SECONDS, Column
from .ladder import PERCEPTUAL, PSNR, Criterion, Ladder, Variant


@dataclass(frozen=True)
class Recommendation:
    title: str  # the ladder's
    method: str  # the row to take, "" where there is no verdict
    headline: str
    beside: str = ""  # what the variants that matter beside it would cost and show, and what was left out

    @property
    def text(self) -> str:
        return f"{self.headline} {self.beside}".strip()


def recommendation(ladder: Ladder) -> Recommendation:
    """The ladder's recommendation, with what the variants that matter beside it would cost and show."""
    taken, best = ladder.recommended, ladder.best
    absent = _absent(ladder)
    if taken is None or best is None:
        least = f"a verdict needs two variants that finished with the same {FEWEST_SEEDS} seeds"
        return Recommendation(ladder.title, "", f"On {ladder.title} no verdict ({absent}): {least}.")
    beside = [
        f"With {variant.method}{role} {_differences(ladder, variant, taken)}, {_cost(ladder, variant, FRAME_MS)}."
        for variant, role in _beside(ladder, taken, best).items()
    ]
    judged = " and ".join(criterion.metric.upper() for criterion in ladder.criteria)
    if PERCEPTUAL[0] not in ladder.criteria:
        beside.append(f"{PERCEPTUAL[0].metric.upper()} was not computed of every run: judged by {judged}.")
    beside += [f"Left out: {absent}."] if absent else []
    headline = f"On {ladder.title} take {taken.method}: {_costs(ladder, taken)}."
    return Recommendation(ladder.title, taken.method, headline, " ".join(beside))


def _beside(ladder: Ladder, taken: Variant, best: Variant) -> dict[Variant, str]:
    """What is to be compared with the variant to take: the best, or, if it is that, the top one; and the cheapest."""
    roles = {}
    if best != taken:
        shown = "within the tolerance" if ladder.verdict(taken) == "within" else "a tie"
        roles[best] = f", the best by PSNR ({shown}):"
    elif ladder.candidates[-1] != taken:
        roles[ladder.candidates[-1]] = ", the top of the ladder:"
    cheapest = ladder.cheapest(ladder.candidates)
    if cheapest not in (taken, *roles):
        roles[cheapest] = ", the cheapest:"
    for criterion in ladder.criteria[1:]:
        for variant in ladder.candidates:
            comparison = criterion.comparison(ladder.difference(taken, variant, criterion.metric))
            if variant not in (taken, *roles) and comparison.worse(by=criterion.tolerance):
                roles[variant] = f", better by {criterion.metric.upper()}:"
    return roles


def _differences(ladder: Ladder, variant: Variant, taken: Variant) -> str:
    return ", ".join(_difference(ladder, variant, taken, criterion) for criterion in ladder.criteria)


def _difference(ladder: Ladder, variant: Variant, taken: Variant, criterion: Criterion) -> str:
    column = next(column for column in SCORES if column.metric == criterion.metric)
    signed = replace(column, against=taken.method)
    found = ladder.difference(variant, taken, criterion.metric)
    if found.mean is None or found.interval is None:
        return f"{column.title} unknown"
    number, ends = signed.text(found.mean), signed.ends(found.interval)
    return f"{number} dB {ends}" if criterion.metric == "psnr" else f"{column.title} {number} {ends}"


def _costs(ladder: Ladder, variant: Variant) -> str:
    primitives = _cost(ladder, variant, PRIMITIVES)
    environment = ladder.value(variant, f"primitives_{ENV}").mean
    if environment:
        primitives += f" ({PRIMITIVES.text(environment)} in the environment)"
    return ", ".join([primitives, *(_cost(ladder, variant, column) for column in (FRAME_MS, MEGABYTES, TRAIN_SECONDS))])


UNITS = {PRIMITIVES: "primitives", FRAME_MS: "ms a frame", MEGABYTES: "MB", TRAIN_SECONDS: "s of training"}


def _cost(ladder: Ladder, variant: Variant, column: Column) -> str:
    mean = ladder.value(variant, column.metric).mean
    return f"{'unknown' if mean is None else column.text(mean)} {UNITS[column]}"


def _absent(ladder: Ladder) -> str:
    """Which variants compete for nothing, by why; "" where all do."""
    found: dict[str, list[str]] = {}
    for variant in ladder.variants:
        finished, attempts = ladder.finished(variant), ladder.attempts(variant)
        if finished < attempts:
            found.setdefault(f"{attempts - finished} of {attempts} runs did not finish", []).append(variant.method)
        elif variant not in ladder.candidates:
            found.setdefault(_seeds(attempts), []).append(variant.method)
        elif ladder.best is not None and ladder.verdict(variant) == "undecided":
            why = f"{_seeds(ladder.against_best(variant, PSNR).done)} in common with {ladder.best.method}"
            found.setdefault(why, []).append(variant.method)
    return "; ".join(f"{', '.join(methods)}: {why}" for why, methods in found.items())


def _seeds(count: int) -> str:
    return f"{count} seed{'s' * (count != 1)}"
