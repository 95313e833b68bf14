"""Repeated timing of one piece of work: the median, and how far the repeats spread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from envgs_bench.stages.stopwatch import time_calls

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
    """Warm up once, then time `repeats` calls, or fewer (at least three) once `seconds` have passed."""
    work()
    return Times(time_calls(work, device, repeats, seconds, at_least=MIN_REPEATS))
