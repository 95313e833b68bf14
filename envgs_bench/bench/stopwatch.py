"""Repeated timing of one piece of work, on a CPU or a GPU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import torch

MIN_REPEATS = 3  # however slow the work: fewer have no spread


@dataclass(frozen=True)
class Times:
    """Milliseconds of each repeat."""

    all_ms: list[float]

    @property
    def median_ms(self) -> float:
        return float(np.median(self.all_ms))

    @property
    def spread_ms(self) -> float:
        """The distance between the quartiles."""
        low, high = np.percentile(self.all_ms, [25, 75])
        return float(high - low)


def time_work(work: Callable[[], object], device: torch.device, repeats: int, seconds: float) -> Times:
    """Warm up once, then time `repeats` calls, or fewer (at least three) once `seconds` have passed.

    On a GPU each call lies between two device events, on a CPU between two readings of `perf_counter`.
    """
    once = time_on_cuda if device.type == "cuda" else time_on_cpu
    once(work)
    times: list[float] = []
    started = perf_counter()
    while len(times) < max(repeats, MIN_REPEATS):
        times.append(once(work))
        if len(times) >= MIN_REPEATS and perf_counter() - started > seconds:
            break
    return Times(times)


def time_on_cpu(work: Callable[[], object]) -> float:
    started = perf_counter()
    work()
    return 1000 * (perf_counter() - started)


def time_on_cuda(work: Callable[[], object]) -> float:
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    start.record()
    work()
    end.record()
    end.synchronize()
    return start.elapsed_time(end)
