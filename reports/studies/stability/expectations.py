"""Expectations: sentences that the numbers of a stability study support, and none that they do not.

A verdict needs an interval over seeds that leaves no other; where there are too few seeds, or none of the intervals
decides, the sentence says that instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ...numbers.comparison import FEWEST_SEEDS
from ...numbers.estimates import Estimate
from .perturbed_runs import FAILURES
from .stability import Case, Cell, Stability

Verdict = Literal["breaks", "behind", "ahead", "open"]


@dataclass(frozen=True)
class Expectation:
    """One sentence, about one method on one data set under one kind of perturbation."""

    dataset: str
    kind: str
    method: str
    verdict: Verdict
    text: str


def expectations(stability: Stability) -> list[Expectation]:
    """What breaks first, then what is to be preferred, then what is not known, by case and method."""
    found = []
    for case in stability.cases:
        for method in stability.methods_of(case):
            for verdict, text in (_breaks(stability, case, method), _compared(stability, case, method)):
                if text:
                    found.append(Expectation(*case, method, verdict, text))
    order = ("breaks", "behind", "ahead", "open")
    return sorted(found, key=lambda item: (item.dataset, order.index(item.verdict)))


def _breaks(stability: Stability, case: Case, method: str) -> tuple[Verdict, str]:
    """The mildest severity at which most runs fail, by the interval of their share."""
    severities = stability.severities(case)
    broken = [s for s in severities if _mostly_fails(stability.cell(case, s, method))]
    if not broken:
        return "breaks", ""
    cell = stability.cell(case, broken[0], method)
    interval = cell.failure_interval
    assert interval is not None
    how = ", ".join(f"{cell.outcomes[name]} {words}" for name, words in FAILURES.items() if cell.outcomes[name])
    share = f"95 % interval of the share {100 * interval.low:.0f} to {100 * interval.high:.0f} %"
    text = f"{method} breaks {_where(stability, case, broken, severities)}: of {len(cell.tried)} runs {how} ({share})"
    return "breaks", text + (f", {cell.silent} of them without any warning." if cell.silent else ", and says so.")


def _mostly_fails(cell: Cell) -> bool:
    interval = cell.failure_interval
    return interval is not None and interval.low > 0.5


def _compared(stability: Stability, case: Case, method: str) -> tuple[Verdict, str]:
    """Whether the baseline is to be preferred, and from which severity on."""
    baseline = stability.baseline(case)
    cells = {s: stability.cell(case, s, method) for s in stability.severities(case)}
    tried = [severity for severity, cell in cells.items() if cell.tried]
    gains = {severity: stability.gain(case, severity, method) for severity in tried}
    if baseline in (None, method) or not gains:
        return "open", ""
    most = max(gain.done for gain in gains.values())
    if most < FEWEST_SEEDS:
        seeds = "one seed" if most == 1 else f"{most} seeds"
        return "open", f"{method} against {baseline}: no verdict from {seeds}, {FEWEST_SEEDS} are the least."
    margin = max((gates.behind_db for gates in stability.gates(case)), default=0.0)
    behind = [s for s in tried if stability.comparison(case, s, method).worse(by=margin)]
    if behind:
        words = _difference(gains[behind[0]], sign=-1)
        return "behind", f"Take {baseline} {_where(stability, case, behind, tried)}: {method} is {words} behind it."
    ahead = [s for s in tried if stability.comparison(case, s, method).better()]
    ahead = [severity for severity in ahead if not cells[severity].failures]
    if ahead == tried:
        words = _difference(gains[tried[-1]])
        return (
            "ahead",
            f"{method} stays ahead of {baseline}, by {words} at severity {_named(stability, case, tried[-1])}.",
        )
    undecided = ", ".join(str(severity) for severity in tried if severity not in ahead)
    why = "no interval excludes that they are equal, or runs failed"
    return "open", f"{method} against {baseline}: no verdict at severity {undecided}: {why}."


def _difference(gain: Estimate, sign: int = 1) -> str:
    assert gain.interval is not None
    assert gain.mean is not None
    low, high = sorted(sign * end for end in gain.interval)
    return f"{sign * gain.mean:.2f} dB (95 % interval {low:.2f} to {high:.2f}, {gain.done} seeds)"


def _where(stability: Stability, case: Case, established: Sequence[int], tried: Sequence[int]) -> str:
    """ "from severity 2 on (…)" where it is so at every severity from there, else those severities alone."""
    first = established[0]
    rest = [severity for severity in tried if severity >= first]
    if list(established) == rest and len(rest) > 1:
        return f"from severity {_named(stability, case, first)} on"
    if len(established) == 1:
        return f"at severity {_named(stability, case, first)}"
    return f"at severities {', '.join(map(str, established))}, first {_named(stability, case, first)}"


def _named(stability: Stability, case: Case, severity: int) -> str:
    return f"{severity} ({stability.level(case, severity)})"
