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
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import torch

from envgs_bench.loggers.opening import logging_of
from envgs_bench.memory import lift_limit, limit_memory
from envgs_bench.records import Failure, Status
from envgs_bench.run_folder import goes_on
from envgs_bench.settings import read_settings
from envgs_bench.stages.events import Event, EventListener
from envgs_bench.stages.execution import execute
from envgs_bench.stages.health import Diverged
from envgs_bench.stages.stop import Stop

from .draft import NOTHING_SAVED, Draft
from .processes import JOB_VARIABLE, LOCK_VARIABLE, end_all_of, end_with

# What PyTorch's CPU allocator, C++ and Python's threads say in a RuntimeError where they were refused memory.
OUT_OF_MEMORY = ("can't allocate memory", "std::bad_alloc", "can't start new thread")


class TimeUp(BaseException):
    """timeout_minutes are over. Not an Exception, so that nothing between here and the worker takes it for its own."""


def main(arguments: list[str]) -> int:
    """Run the run of the folder named in `arguments`; 0 where it ended with status ok."""
    stop = Stop()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.ask(KeyboardInterrupt()))
    _join_job()
    report = _reporter(_take_standard_output())
    faulthandler.enable()
    folder = Path(arguments[0])
    settings = read_settings(folder)
    draft = Draft(folder, settings)
    _start_clock(settings.timeout_minutes, stop)
    status: Status = "ok"
    failure = None
    try:
        limit_memory(settings.memory_gb, settings.device_memory_fraction, settings.device)
        with logging_of(settings, folder) as logger:
            execute(settings, folder, draft.results, report, stop, logger)
        _ignore_signals()  # what is finished is recorded
    except BaseException as error:
        _ignore_signals()
        lift_limit()
        with suppress(OSError):  # the job, which reads it, may be gone
            traceback.print_exc()
            sys.stderr.flush()
        # Half an import, cut off by the request to end, can fail in a way of its own.
        reason = stop.reason or error
        status = _status(reason)
        message = _message(reason, folder)
        failure = Failure(type=type(reason).__name__, message=message, log_tail="")  # which the job adds
    draft.write(status, failure)
    return 0 if status == "ok" else 1


def _join_job() -> None:
    """End with the job, and keep its lock on the folder until then, but not beyond: nothing started here has it."""
    if LOCK_VARIABLE in os.environ:
        os.set_inheritable(int(os.environ.pop(LOCK_VARIABLE)), False)
    if JOB_VARIABLE in os.environ:
        end_with(int(os.environ[JOB_VARIABLE]))


def _ignore_signals() -> None:
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


def leave(code: int, folder: Path) -> NoReturn:
    """End this process now: threads that a method left running, and what else would be waited for, end with it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    if JOB_VARIABLE in os.environ and os.getppid() != int(os.environ[JOB_VARIABLE]):
        end_all_of(folder)  # the job, which would do so, is gone
    os._exit(code)


def _start_clock(minutes: float | None, stop: Stop) -> None:
    """Have `stop` asked when the minutes are over, and whenever it wants to be asked again."""
    message = "" if minutes is None else f"not finished after timeout_minutes={minutes:g}"
    signal.signal(signal.SIGALRM, lambda *_: stop.ask(TimeUp(message)))
    if minutes is not None:
        signal.setitimer(signal.ITIMER_REAL, 60 * minutes)


def _status(error: BaseException) -> Status:
    if isinstance(error, TimeUp):
        return "timeout"
    if isinstance(error, KeyboardInterrupt | BrokenPipeError):
        return "interrupted"
    if isinstance(error, Diverged):
        return "diverged"
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or any(words in str(error) for words in OUT_OF_MEMORY):
        return "out_of_memory"
    return "failed"


def _message(error: BaseException, folder: Path) -> str:
    if isinstance(error, KeyboardInterrupt):
        going_on = "interrupted; the same command goes on from where the training was saved last"
        return going_on if goes_on(folder) else NOTHING_SAVED
    if isinstance(error, BrokenPipeError):
        return "the process that started this run is gone"
    return str(error) or type(error).__name__


def _take_standard_output() -> int:
    """The pipe that progress goes to; from now on what anyone prints goes to standard error."""
    pipe = os.dup(1)
    os.dup2(2, 1)
    return pipe


def _reporter(pipe: int) -> EventListener:
    """Writes events into `pipe`. Where nobody reads them for a while they are dropped: a run does not wait for that."""
    os.set_blocking(pipe, False)
    unsent = b""

    def report(event: Event) -> None:
        nonlocal unsent
        content = unsent + json.dumps(event).encode() + b"\n"
        with suppress(BlockingIOError):
            unsent = content[os.write(pipe, content) :]

    return report


if __name__ == "__main__":
    leave(main(sys.argv[1:]), Path(sys.argv[1]))
