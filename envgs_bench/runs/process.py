"""Process: the process of one run, from its start to a record, whatever becomes of it and of those that watch it."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Literal

from envgs_bench.records import Failure, Record, RecordError, Status, TrainingWarning, read_record, write_record
from envgs_bench.run_folder import LOG_NAME, goes_on
from envgs_bench.run_lock import RunLock
from envgs_bench.settings import RunSettings

from .display import Display
from .draft import NOTHING_SAVED, Draft
from .gpus import Place, placed
from .interruption import Interruption
from .log import BoundedLog, log_tail
from .processes import end_all_of, end_group
from .started_run import StartedRun

# How long a process may take to write its record once its time is up or it was interrupted.
GRACE_SECONDS = 20.0
POLL_SECONDS = 0.5  # how often to look whether the sweep is to end
DRAIN_SECONDS = 2.0  # how long what a process printed may take to be read once all processes of the run are gone
NOTE_SECONDS = 1.0  # how often the lock says how far the run has come

Ending = Literal["by itself", "timed out", "interrupted"]


def run_process(
    folder: Path, settings: RunSettings, device: str, run_lock: RunLock, display: Display, interruption: Interruption
) -> None:
    """Start the run's process on `device`, show its progress, and see to it that there is a record when it is gone."""
    with placed(device) as place:
        _run_placed(folder, settings, run_lock, place, display, interruption)


def _run_placed(
    folder: Path, settings: RunSettings, run_lock: RunLock, place: Place, display: Display, interruption: Interruption
) -> None:
    draft = Draft(folder, settings)
    process = StartedRun(folder, run_lock.handle, place.environment, place.handles)
    log = BoundedLog(process.stderr, folder)
    listener = _Listener(process, run_lock, display, draft)
    try:
        log.start()
        title = f"{settings.dataset_name} · {settings.method_name} · seed {settings.seed}"
        listener.shows = _started(display, title)
        listener.start()
        ending = _await(process, settings, interruption)
    finally:
        end_group(process.pid)
        code = process.wait()
        end_all_of(folder)  # what left the group
        listener.join(DRAIN_SECONDS)
        log.finish(DRAIN_SECONDS)
        with suppress(Exception):
            display.stop()
    _complete_record(draft, code, ending)


class _Listener(threading.Thread):
    """Reads the process's events to their end, whether or not anybody can show them.

    What it trains without and warns of goes into the draft too, lest the process leave no record.
    """

    def __init__(self, process: StartedRun, run_lock: RunLock, display: Display, draft: Draft) -> None:
        super().__init__(daemon=True)
        self._process, self._run_lock, self._display, self._draft = process, run_lock, display, draft
        self.shows = True

    def run(self) -> None:
        noted, began = 0.0, {"stage": "", "began": 0.0, "first": 0}
        for line in self._process.stdout:
            try:
                event = json.loads(line)
                stage = str(event["stage"])
                warnings = [TrainingWarning.model_validate(event["warning"])] if "warning" in event else []
            except (ValueError, KeyError, TypeError, RecursionError):
                continue  # the process died in the middle of a line
            self._draft.results.notes += event.get("notes", [])
            self._draft.results.dropped_losses |= event.get("dropped_losses", {})
            self._draft.results.warnings += warnings
            now = time.time()
            if stage != began["stage"]:
                began, noted = {"stage": stage, "began": now, "first": event.get("step", 0)}, 0.0
            if abs(now - noted) > NOTE_SECONDS:
                noted = now
                self._run_lock.note({**event, **began})
            if self.shows:
                try:
                    self._display.update(event)
                except Exception:  # a terminal that is gone
                    self.shows = False


def _started(display: Display, title: str) -> bool:
    try:
        display.start(title)
    except Exception:
        return False
    return True


def _await(process: StartedRun, settings: RunSettings, interruption: Interruption) -> Ending:
    """Wait for the process's end, and pass on to it that the sweep is to end."""
    limit = None if settings.timeout_minutes is None else 60 * settings.timeout_minutes + GRACE_SECONDS
    deadline = None if limit is None else time.monotonic() + limit
    told: float | None = None

    def tell() -> None:
        nonlocal told
        if told is None and process.poll() is None:
            told = time.monotonic()
            process.send_signal(signal.SIGINT)
            print("interrupted: waiting for the run to save its snapshot and its record", file=sys.stderr, flush=True)

    interruption.on_request = tell
    try:
        while True:
            if interruption.requested:
                tell()
            try:
                process.wait(POLL_SECONDS)
                return "by itself" if told is None else "interrupted"
            except TimeoutError:
                pass
            if told is not None and (interruption.insisted or time.monotonic() - told > GRACE_SECONDS):
                return "interrupted"
            if deadline is not None and time.monotonic() > deadline:
                return "timed out"
    finally:
        interruption.on_request = None


def _complete_record(draft: Draft, code: int, ending: Ending) -> None:
    """Write the record that the process left none of; put the log's tail into that of a failure."""
    record = _readable(draft.folder)
    tail = log_tail(draft.folder)
    if record is None:
        status, failure = _diagnosis(code, draft, ending)
        draft.write(status, failure.model_copy(update={"log_tail": tail}))
    elif record.error is not None and tail:
        error = record.error.model_copy(update={"log_tail": tail})
        write_record(draft.folder, record.model_copy(update={"error": error}))


def _readable(folder: Path) -> Record | None:
    try:
        return read_record(folder)
    except RecordError:
        return None


def _diagnosis(code: int, draft: Draft, ending: Ending) -> tuple[Status, Failure]:
    """What to record of a process that ended with exit code `code` and left no record."""
    if ending == "interrupted":
        message = "killed while it was saving" if goes_on(draft.folder) else NOTHING_SAVED
        return "interrupted", Failure(type="KeyboardInterrupt", message=message, log_tail="")
    if ending == "timed out":
        message = f"did not end within timeout_minutes={draft.settings.timeout_minutes:g} and was killed"
        return "timeout", Failure(type="TimeUp", message=message, log_tail="")
    if code == -signal.SIGKILL:
        message = "killed by SIGKILL from outside: most often the system ran out of memory"
        return "out_of_memory", Failure(type="SIGKILL", message=message, log_tail="")
    if code < 0:
        name = signal.Signals(-code).name
        return "failed", Failure(type=name, message=f"the process died of {name}; see {LOG_NAME}", log_tail="")
    message = f"the process ended with exit code {code} and left no record; see {LOG_NAME}"
    return "failed", Failure(type="ProcessError", message=message, log_tail="")
