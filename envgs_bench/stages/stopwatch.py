"""Stopwatch: how long each of several calls takes, on a CPU's clock or on a GPU's."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import torch


def time_calls(
    work: Callable[[], Any], device: torch.device, repeats: int, seconds: float, *, at_least: int = 1, queued: int = 1
) -> list[float]:
    """Milliseconds of each call of `work`, which the caller has warmed up.

    On a CPU `perf_counter` is read before and after each call, on a GPU each lies between two device events.

    Args:
        device: where the work is done.
        repeats: most calls.
        seconds: no call is begun after this time, but for the first `at_least`.
        at_least: fewest calls, however long they take.
        queued: how many calls may be under way on a GPU at once, so that launching overlaps working.
    """
    if device.type == "cuda":
        return _time_on_cuda(work, repeats, seconds, at_least, queued)
    times_ms: list[float] = []
    started = perf_counter()
    while _another(len(times_ms), repeats, at_least, started, seconds):
        before = perf_counter()
        work()
        times_ms.append(1000 * (perf_counter() - before))
    return times_ms


def _time_on_cuda(work: Callable[[], Any], repeats: int, seconds: float, at_least: int, queued: int) -> list[float]:
    torch.cuda.synchronize()
    events: list[tuple[torch.cuda.Event, torch.cuda.Event]] = []
    started = perf_counter()
    while _another(len(events), repeats, at_least, started, seconds):
        before, after = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        before.record()
        work()
        after.record()
        events.append((before, after))
        if len(events) >= queued:  # or all would be launched before the first has ended, whatever `seconds` say
            events[-queued][1].synchronize()
    torch.cuda.synchronize()
    return [before.elapsed_time(after) for before, after in events]


def _another(done: int, repeats: int, at_least: int, started: float, seconds: float) -> bool:
    return done < max(repeats, at_least) and (done < at_least or perf_counter() - started < seconds)
