"""The process of one run, `python -m envgs_bench.runs.worker <run folder>`: does what it does, and leaves a record.

Reads config.yaml from the folder. Progress goes to standard output as one JSON object a line; everything else that is
printed, by Python or by native code, goes to standard error, which the parent makes log.txt.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import TextIO

import torch

from envgs_bench.records import Failure, Status
from envgs_bench.settings import read_settings
from envgs_bench.stages.events import Event, EventListener
from envgs_bench.stages.execution import execute
from envgs_bench.stages.health import Diverged

from .draft import Draft, log_tail


class TimeUp(BaseException):
    """timeout_minutes are over. Not an Exception, so that nothing between here and the worker takes it for its own."""


def main(arguments: list[str]) -> int:
    """Run the run of the folder named in `arguments`; 0 where it ended with status ok."""
    report = _reporter(_take_standard_output())
    faulthandler.enable()
    folder = Path(arguments[0])
    settings = read_settings(folder)
    draft = Draft(folder, settings)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    _start_clock(settings.timeout_minutes)
    status: Status = "ok"
    failure = None
    try:
        execute(settings, folder, draft.results, report)
    except BaseException as error:
        signal.setitimer(signal.ITIMER_REAL, 0)
        traceback.print_exc()
        sys.stderr.flush()
        status = _status(error)
        failure = Failure(type=type(error).__name__, message=_message(error), log_tail=log_tail(folder))
    draft.write(status, failure)
    return 0 if status == "ok" else 1


def _start_clock(minutes: float | None) -> None:
    def ring(number: int, frame: FrameType | None) -> None:
        raise TimeUp(f"not finished after timeout_minutes={minutes:g}")

    if minutes is not None:
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, 60 * minutes)


def _status(error: BaseException) -> Status:
    if isinstance(error, TimeUp):
        return "timeout"
    if isinstance(error, KeyboardInterrupt | BrokenPipeError):
        return "interrupted"
    if isinstance(error, Diverged):
        return "diverged"
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or "can't allocate memory" in str(error):
        return "out_of_memory"  # PyTorch's CPU allocator says it in a RuntimeError
    return "failed"


def _message(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; what was learned is in checkpoint/"
    if isinstance(error, BrokenPipeError):
        return "the process that started this run is gone"
    return str(error) or type(error).__name__


def _take_standard_output() -> TextIO:
    """The stream that progress goes to; from now on what anyone prints goes to standard error."""
    stream = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    return stream


def _reporter(stream: TextIO) -> EventListener:
    def report(event: Event) -> None:
        stream.write(json.dumps(event) + "\n")

    return report


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
