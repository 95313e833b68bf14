"""Perturbed runs: each beside its unperturbed partner, and whether it survived the gates that it carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import ValidationError

from envgs_bench.parts import REFLECTIVE
from envgs_bench.records import Record
from envgs_bench.settings import Gates

from ...numbers.runs import Run

SURVIVED = "survived"
FAILURES = {  # outcome -> in words; the first three are of runs that finished
    "collapsed": "collapsed",
    "exploded": "exploded",
    "slow": "took too long",
    "diverged": "diverged",
    "failed": "crashed",
    "out_of_memory": "ran out of memory",
    "timeout": "timed out",
}
UNTRIED = {  # says nothing of the method
    "interrupted": "interrupted",
    "impossible": "impossible here",  # the scene lacks what is to be perturbed
}
SCENE_ERROR = "DatasetError"  # of a run whose scene could not be read, or not be perturbed


def _score(name: str, region: str = "full") -> Callable[[Run], float | None]:
    def of(run: Run) -> float | None:
        record = run.record
        if region != "full":
            return record.masked[region].scores.get(name) if region in record.masked else None
        return record.metrics.mean.get(name) if record.metrics else None

    return of


def _view_psnr(percent: float) -> Callable[[Run], float | None]:
    def of(run: Run) -> float | None:
        found = list(run.of_views("psnr").values())
        return float(np.percentile(found, percent)) if found else None

    return of


def _cost(name: str) -> Callable[[Run], float | None]:
    def of(run: Run) -> float | None:
        found = None if run.record.cost is None else getattr(run.record.cost, name)
        return None if found is None else float(found)

    return of


def _primitives(run: Run) -> float | None:
    cost = run.record.cost
    return float(sum(cost.primitives.values())) if cost is not None and cost.primitives else None


def peak_memory(run: Run) -> float | None:
    """Bytes: the device's where there is one, the process's elsewhere."""
    cost = run.record.cost
    if cost is None:
        return None
    found = cost.peak_host_bytes if cost.peak_device_bytes is None else cost.peak_device_bytes
    return None if found is None else float(found)


QUANTITIES: Mapping[str, Callable[[Run], float | None]] = {  # of a finished run, in the records' units
    "psnr": _score("psnr"),
    "psnr_reflective": _score("psnr", REFLECTIVE),
    "psnr_aligned": _score("psnr_aligned"),
    "psnr_median_view": _view_psnr(50),
    "psnr_p5_view": _view_psnr(5),
    "psnr_worst_view": _view_psnr(0),
    "normal_degrees": _score("normal_degrees"),
    "primitives": _primitives,
    "peak_primitives": _cost("peak_primitives"),
    "peak_memory_bytes": peak_memory,
    "train_seconds": _cost("train_seconds"),
    "skipped_steps": _cost("skipped_steps"),
}


@dataclass(frozen=True)
class PerturbedRun:
    """A run, perturbed or not, beside the runs of its seed that it is judged against.

    Attributes:
        partner: the unperturbed run of the same data set, method, settings, steps and seed; None where there is none,
            and for an unperturbed run.
        rival: the run of the gates' baseline, perturbed alike; None where there is none or it is this method.
    """

    run: Run
    partner: Run | None = None
    rival: Run | None = None

    @property
    def record(self) -> Record:
        return self.run.record

    @property
    def paired(self) -> bool:
        """Whether there is a finished partner to compare with."""
        return self.partner is not None and self.partner.ok

    @cached_property
    def gates(self) -> Gates | None:
        """None where the run carries none, or none that can be read."""
        return gates_of(self.record)

    @cached_property
    def outcome(self) -> str:
        """SURVIVED, or a key of FAILURES or of UNTRIED. Without a finished partner or gates, by status alone."""
        record = self.record
        if record.status != "ok":
            lacking = record.status == "failed" and record.error is not None and record.error.type == SCENE_ERROR
            return "impossible" if lacking else record.status
        gates = self.gates
        if gates is None or not self.paired:
            return SURVIVED
        limits = {"psnr": gates.psnr_drop_db, "psnr_reflective": gates.region_drop_db}
        if any((drop := self.drop(name)) is not None and drop > limit for name, limit in limits.items()):
            return "collapsed"
        factors = {"peak_primitives": gates.count_factor, "peak_memory_bytes": gates.memory_factor}
        if any(self._grew(name, factor) for name, factor in factors.items()):
            return "exploded"
        return "slow" if self._grew("train_seconds", gates.time_factor) else SURVIVED

    @property
    def failed(self) -> bool:
        return self.outcome in FAILURES

    @property
    def silent(self) -> bool:
        """Whether it failed and nothing says so: its status, a warning, or a loss dropped that its partner has."""
        dropped = set(self.record.dropped_losses.items())
        if self.partner is not None:
            dropped -= set(self.partner.record.dropped_losses.items())
        return self.failed and self.run.ok and not self.record.warnings and not dropped

    @property
    def behind(self) -> bool | None:
        """Whether it is further behind its rival than the gates allow, or failed where that finished; None: unknown."""
        if self.rival is None or not self.rival.ok or self.gates is None or self.outcome in UNTRIED:
            return None
        own, theirs = value(self.run, "psnr"), value(self.rival, "psnr")
        if theirs is None:
            return None
        return own is None or own < theirs - self.gates.behind_db

    def drop(self, quantity: str) -> float | None:
        """The partner's value minus this run's; None unless both finished and have it."""
        own = value(self.run, quantity)
        theirs = value(self.partner, quantity) if self.partner is not None else None
        return None if own is None or theirs is None else theirs - own

    def _grew(self, quantity: str, factor: float) -> bool:
        drop, own = self.drop(quantity), value(self.run, quantity)
        return drop is not None and own is not None and own > factor * (own + drop)


def value(run: Run, quantity: str) -> float | None:
    """One of QUANTITIES of the run; None unless it finished and has it."""
    return QUANTITIES[quantity](run) if run.ok else None


def gates_of(record: Record) -> Gates | None:
    """The gates in a record's configuration, None where there are none that can be read."""
    try:
        return Gates.model_validate(record.config["gates"])
    except (KeyError, ValidationError):
        return None
