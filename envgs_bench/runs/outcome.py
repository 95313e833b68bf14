"""Outcome: what became of one job."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from envgs_bench.parts import LOSSES
from envgs_bench.records import Record, RecordError, read_record
from envgs_bench.settings import RunSettings


@dataclass(frozen=True)
class Outcome:
    """One job. `action` is ran, reused, not retried, skipped (another process runs it), unreadable or left alone."""

    dataset: str
    method: str
    seed: int
    status: str  # the record's; "" where there is none to read
    action: str
    message: str  # what the user should know or do, "" where all is well
    psnr: float | None
    frame_ms: float | None
    train_seconds: float | None
    folder: str
    root: str = ""  # of its data
    data: str | None = None  # their hash
    remarks: dict[str, str] = field(default_factory=dict)  # `remarks_of` its record

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    @property
    def name(self) -> str:
        return f"{self.dataset} · {self.method} · seed {self.seed}"

    @property
    def run(self) -> str:
        """The hash in the folder's name, which tells runs of one method apart."""
        return self.folder.rpartition("-")[2]

    @property
    def state(self) -> str:
        """The status, with what was done where it was not to run."""
        return self.status if self.action == "ran" else f"{self.status} ({self.action})".strip()

    def __str__(self) -> str:
        return f"{self.name}: {self.state}, {self.folder}"


def outcome_of(folder: Path, settings: RunSettings, action: str, message: str = "", failed: str = "") -> Outcome:
    """The outcome of a job, from the record in `folder`; of status `failed` where that is given."""
    record: Record | None
    try:
        record = read_record(folder)
    except RecordError:
        record = None
    if record and record.error and not failed:
        message = f"{record.error} ({message})" if message else str(record.error)
    return Outcome(
        dataset=record.dataset if record else settings.dataset_name,
        method=settings.method_name,
        seed=settings.seed,
        status=failed or (record.status if record else ""),
        action=action,
        message=message,
        psnr=record.metrics.mean.get("psnr") if record and record.metrics else None,
        frame_ms=record.timing.frame_ms if record and record.timing else None,
        train_seconds=record.cost.train_seconds if record and record.cost else None,
        folder=str(folder),
        root=str(settings.dataset.get("root") or ""),
        data=record.data if record else None,
        remarks=remarks_of(record) if record else {},
    )


def remarks_of(record: Record) -> dict[str, str]:
    """What was noticed of the run and its data, and which losses it trained without, a phrase each.

    Keys are equal where phrases say the same: warnings of several runs differ in their numbers.
    """
    phrases = [
        *record.notes,
        *(f"without {LOSSES.get(loss, loss)}: {why}" for loss, why in record.dropped_losses.items()),
    ]
    remarks = {phrase: phrase for phrase in phrases}
    for warning in record.warnings:
        words = f"warning: {warning.kind} {warning.part}".rstrip().replace("_", " ")
        remarks.setdefault(words, f"{words}: {warning.message}")
    return remarks
