"""Job: one run, from its settings to its record. Reuses what is there, starts a process, and survives its death."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from envgs_bench.records import RecordError, Status, read_record, write_atomically
from envgs_bench.run_folder import (
    CONFIG_NAME,
    CURVE_NAME,
    LOG_NAME,
    LOGGED,
    PROGRAM,
    RECORD_NAME,
    REPLACEMENT,
    SNAPSHOT_NAME,
    clear,
    goes_on,
    replace,
)
from envgs_bench.run_lock import RunLock, holder_of, locked
from envgs_bench.settings import RunSettings, SettingsError

from .cuda_probe import has_driver, surely_usable
from .display import Display
from .gpus import visible_gpus
from .identity import run_id
from .interruption import Interruption
from .outcome import Outcome, outcome_of
from .process import GRACE_SECONDS, run_process
from .processes import end_all_of

GOES_ON_FROM = (SNAPSHOT_NAME, PROGRAM, CURVE_NAME, LOG_NAME, LOGGED)  # kept of a run that did not end


def located(settings: RunSettings) -> tuple[RunSettings, Path]:
    """The settings with the device that they mean here, and the folder of their run.

    Raises:
        SettingsError: the device cannot be had.
    """
    settings = settings.model_copy(update={"device": resolve_device(settings.device)})
    name = run_id(settings, device_type(settings.device))
    return settings, settings.runs_dir / settings.dataset_name / settings.method_name / name


def run_job(settings: RunSettings, folder: Path, display: Display, interruption: Interruption) -> Outcome:
    """Run what `settings` say in `folder`, unless its record is there already; raises for nothing that happens there.

    A run with status ok is reused unless `force`; it stays in place until the one that replaces it is ok too. One that
    was interrupted goes on from its snapshot; one that ended otherwise does so only with `retry`, and starts again
    with `force`. An unreadable record is replaced only with `force`.

    Ctrl-C ends the run, with a record of status interrupted.
    """
    try:
        if folder.is_symlink() and settings.force:
            reason = "the folder is a link, and what it leads to may be another run's: remove it, or give a runs_dir"
            return outcome_of(folder, settings, "left alone", reason)
        earlier = None if (folder / REPLACEMENT).exists() else earlier_outcome(folder, settings)
        if earlier is not None:
            return earlier  # without a lock: what is finished may lie where nothing can be written
        folder.mkdir(parents=True, exist_ok=True)
        with _taken(folder) as run_lock:
            if run_lock is None:
                return outcome_of(
                    folder, settings, "skipped", f"{holder_of(folder) or 'another process'} is running it"
                )
            return _run_locked(settings, folder, run_lock, display, interruption)
    except OSError as error:
        return outcome_of(folder, settings, "ran", f"{type(error).__name__}: {error}", failed="failed")


def resolve_device(wanted: str) -> str:
    """ "cpu", "cuda" or one GPU, as "cuda:1"; auto takes cuda where PyTorch sees a device and the cuda backend works.

    Raises:
        SettingsError: cuda was asked for and does not work here, or has no such GPU; the message says why.
    """
    if wanted == "cpu" or (wanted == "auto" and not has_driver()):
        return "cpu"
    reason = None if surely_usable() else _why_no_cuda()
    if wanted == "auto":
        return "cpu" if reason else "cuda"
    if reason:
        raise SettingsError(f"device={wanted}: {reason}; use device=cpu or device=auto")
    number, count = wanted.partition(":")[2], len(visible_gpus())
    if number and int(number) >= count:
        raise SettingsError(f"device={wanted}: this machine shows {count} GPUs, the last one is cuda:{count - 1}")
    return wanted


def _why_no_cuda() -> str | None:
    """Why the cuda backend does not work here, by PyTorch, which takes seconds to import; None where it does."""
    import torch

    from envgs_bench.core import available_backends

    return available_backends()["cuda"] if torch.cuda.is_available() else "PyTorch sees no CUDA device"


def device_type(device: str) -> str:
    """ "cpu" or "cuda": the process of a run sees one GPU, whichever it is."""
    return device.partition(":")[0]


def earlier_outcome(folder: Path, settings: RunSettings) -> Outcome | None:
    """The outcome of the run that is there already, or None where it is to be run (again)."""
    if settings.force or not (folder / RECORD_NAME).exists():
        return None
    try:
        status = read_record(folder).status
    except RecordError as error:
        return outcome_of(folder, settings, "unreadable", str(error))
    if status == "ok":
        return outcome_of(folder, settings, "reused")
    if status == "interrupted" or settings.retry in ("failed", status):
        return None
    return outcome_of(folder, settings, "not retried", "retry=failed runs it again")


def _run_locked(
    settings: RunSettings, folder: Path, run_lock: RunLock, display: Display, interruption: Interruption
) -> Outcome:
    replacement = folder / REPLACEMENT
    if _status(replacement) == "ok":
        replace(folder)  # whoever ran it was killed in doing so
    earlier = earlier_outcome(folder, settings)
    if earlier is not None:
        return earlier
    if _status(folder) != "ok":
        _start_over(folder, keep=() if settings.force else GOES_ON_FROM)
        _run_in(folder, settings, run_lock, display, interruption)
        return outcome_of(folder, settings, "ran")
    replacement.mkdir(exist_ok=True)
    # A replacement that was interrupted goes on.
    _start_over(replacement, keep=GOES_ON_FROM if _status(replacement) in (None, "interrupted") else ())
    _run_in(replacement, settings, run_lock, display, interruption)
    if _status(replacement) != "ok":
        return outcome_of(replacement, settings, "ran", f"the earlier result is kept in {folder}")
    replace(folder)
    return outcome_of(folder, settings, "ran")


def _start_over(folder: Path, keep: tuple[str, ...]) -> None:
    """Remove what an earlier attempt left, but for `keep` where there is something to go on from."""
    clear(folder, keep if goes_on(folder) else ())


def _run_in(
    folder: Path, settings: RunSettings, run_lock: RunLock, display: Display, interruption: Interruption
) -> None:
    device, settings = settings.device, settings.model_copy(update={"device": device_type(settings.device)})
    write_atomically(folder / CONFIG_NAME, yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
    run_process(folder, settings, device, run_lock, display, interruption)


def _status(folder: Path) -> Status | None:
    try:
        return read_record(folder).status if (folder / RECORD_NAME).is_file() else None
    except RecordError:
        return None


@contextmanager
def _taken(folder: Path) -> Iterator[RunLock | None]:
    """The lock on the folder, taken from what is left of a job that was killed; None where a living one has it."""
    ends = time.monotonic() + GRACE_SECONDS
    while True:
        with locked(folder) as run_lock:
            holder = holder_of(folder) if run_lock is None else None
            if run_lock is not None or holder is None or not holder.is_gone:
                yield run_lock
                return
        if time.monotonic() > ends:  # it saves nothing any more
            end_all_of(folder)
            end_all_of(folder / REPLACEMENT)
        time.sleep(0.1)
