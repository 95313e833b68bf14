"""Job: one run, from its settings to its record. Reuses what is there, starts a process, and survives its death."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import torch
import yaml

from envgs_bench.core import available_backends
from envgs_bench.records import Failure, Record, RecordError, Status, TrainingWarning, read_record, write_atomically
from envgs_bench.run_folder import CONFIG_NAME, LOG_NAME, RECORD_NAME
from envgs_bench.settings import RunSettings, SettingsError

from .display import Display
from .draft import Draft, log_tail
from .identity import run_id
from .outcome import Outcome, outcome_of

# How long a process may take to write its record once its time is up or it was interrupted.
GRACE_SECONDS = 20.0


def run_job(settings: RunSettings, display: Display) -> Outcome:
    """Run what `settings` say, unless its record is there already; never raises for what happens inside the run.

    A run with status ok is reused unless `force`. One that was interrupted starts again; one that ended otherwise
    does so only with `retry_failed` or `force`. An unreadable record is replaced only with `force`.

    Ctrl-C ends the run, with a record of status interrupted.

    Raises:
        SettingsError: the device cannot be had.
    """
    settings = settings.model_copy(update={"device": resolve_device(settings.device)})
    folder = settings.runs_dir / settings.dataset_name / settings.method_name / run_id(settings, settings.device)
    folder.mkdir(parents=True, exist_ok=True)
    with _claimed(folder) as claimed:
        if not claimed:
            return outcome_of(folder, settings, "skipped", "another process is running it at this moment")
        earlier = None if settings.force else _earlier(folder, settings)
        if earlier is not None:
            return earlier
        _clear(folder)
        write_atomically(folder / CONFIG_NAME, yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
        _run_process(folder, settings, display)
        return outcome_of(folder, settings, "ran")


def resolve_device(wanted: str) -> str:
    """ "cpu" or "cuda"; auto takes cuda where PyTorch sees a device and the cuda backend works.

    Raises:
        SettingsError: cuda was asked for and does not work here; the message says why.
    """
    if wanted == "cpu":
        return "cpu"
    if not torch.cuda.is_available():
        reason: str | None = "PyTorch sees no CUDA device"
    else:
        reason = available_backends()["cuda"]
    if reason is None:
        return "cuda"
    if wanted == "cuda":
        raise SettingsError(f"device=cuda: {reason}; use device=cpu or device=auto")
    return "cpu"


def _earlier(folder: Path, settings: RunSettings) -> Outcome | None:
    """The outcome of the run that is there already, or None where it is to be run (again)."""
    if not (folder / RECORD_NAME).exists():
        return None
    try:
        status = read_record(folder).status
    except RecordError as error:
        return outcome_of(folder, settings, "unreadable", str(error))
    if status == "ok":
        return outcome_of(folder, settings, "reused")
    if status == "interrupted" or settings.retry_failed:
        return None
    return outcome_of(folder, settings, "not retried", "retry_failed=true runs it again")


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


@contextmanager
def _claimed(folder: Path) -> Iterator[bool]:
    """Whether this process, and nobody else, may write into `folder`. The run's process inherits the claim."""
    handle = os.open(folder, os.O_RDONLY)
    os.set_inheritable(handle, True)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield True
    except BlockingIOError:
        yield False
    finally:
        os.close(handle)


def _run_process(folder: Path, settings: RunSettings, display: Display) -> None:
    """Start the run's process, show its progress, and see to it that there is a record when it is gone."""
    draft = Draft(folder, settings)
    command = [sys.executable, "-P", "-u", "-m", f"{__package__}.worker", str(folder)]
    with (folder / LOG_NAME).open("wb") as log:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            start_new_session=True,  # Ctrl-C reaches this process, which passes it on
            close_fds=False,  # the claim
        )
    display.start(f"{settings.dataset_name} · {settings.method_name} · seed {settings.seed}")
    reader = threading.Thread(target=_show, args=(process, display, draft), daemon=True)
    reader.start()
    timed_out = interrupted = False
    try:
        limit = None if settings.timeout_minutes is None else 60 * settings.timeout_minutes + GRACE_SECONDS
        process.wait(limit)
    except subprocess.TimeoutExpired:
        timed_out = True
    except KeyboardInterrupt:
        interrupted = True
        _interrupt(process)
    finally:
        _kill(process)
        reader.join(GRACE_SECONDS)
        display.stop()
    if _readable(folder) is None:
        status, failure = _diagnosis(process.returncode, settings, timed_out, interrupted)
        draft.write(status, failure.model_copy(update={"log_tail": log_tail(folder)}))


def _show(process: subprocess.Popen[bytes], display: Display, draft: Draft) -> None:
    """Show the process's events; what it trains without and warns of goes into `draft`: it may leave no record."""
    assert process.stdout is not None
    for line in process.stdout:
        try:
            event = json.loads(line)
        except ValueError:
            continue  # the process died in the middle of a line
        draft.results.dropped_losses |= event.get("dropped_losses", {})
        if "warning" in event:
            draft.results.warnings.append(TrainingWarning.model_validate(event["warning"]))
        display.update(event)


def _interrupt(process: subprocess.Popen[bytes]) -> None:
    """Ask the process to end, and wait for its record; a second Ctrl-C stops the waiting."""
    print("interrupted: waiting for the run to save its checkpoint and its record", file=sys.stderr)
    with suppress(KeyboardInterrupt, subprocess.TimeoutExpired):
        process.send_signal(signal.SIGINT)
        process.wait(GRACE_SECONDS)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the process and all that it started, unless it has ended."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _readable(folder: Path) -> Record | None:
    try:
        return read_record(folder)
    except RecordError:
        return None


def _diagnosis(code: int, settings: RunSettings, timed_out: bool, interrupted: bool) -> tuple[Status, Failure]:
    """What to record of a process that ended with exit code `code` and left no record."""
    if interrupted:
        return "interrupted", Failure(type="KeyboardInterrupt", message="killed while it was saving", log_tail="")
    if timed_out:
        message = f"did not end within timeout_minutes={settings.timeout_minutes:g} and was killed"
        return "timeout", Failure(type="TimeUp", message=message, log_tail="")
    if code == -signal.SIGKILL:
        message = "killed by SIGKILL from outside: most often the system ran out of memory"
        return "out_of_memory", Failure(type="SIGKILL", message=message, log_tail="")
    if code < 0:
        name = signal.Signals(-code).name
        return "failed", Failure(type=name, message=f"the process died of {name}; see {LOG_NAME}", log_tail="")
    message = f"the process ended with exit code {code} and left no record; see {LOG_NAME}"
    return "failed", Failure(type="ProcessError", message=message, log_tail="")
