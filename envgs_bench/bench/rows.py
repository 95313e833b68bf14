"""Rows: one case timed, as a dictionary of plain numbers."""

from __future__ import annotations

import gc
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from .cases import PEERS, ROOM, Case
from .operations import work_of
from .repeats import time_work
from .room_workload import RoomWorkload
from .workload import Workload

if TYPE_CHECKING:
    from .run_workload import TimedRun

SECONDS_PER_CASE = 10.0

Row = dict[str, object]


def time_case(case: Case, repeats: int, run: TimedRun | None = None) -> Row:
    """Time one case; the row of the result.

    | key | meaning |
    |---|---|
    | the case's own fields | |
    | median_ms, spread_ms | of `repeats` calls or fewer: the median, the distance between the quartiles; of several views the means of theirs |
    | hits_per_ray, hits_p50, hits_p99, hits_max | of pixels or rays; None where nothing is hit |
    | lists_p50, lists_p99, lists_max | lengths of the tiles' lists; None where there are none |
    | alpha | the mean, None without a picture |
    | peak_bytes | the most memory that the case's tensors took on a GPU at once, inputs included; None on a CPU |
    | bytes_per_primitive | that, by the primitives of all sets |

    Args:
        case: of the room, or of `run`.
        repeats: timed calls.
    """  # noqa: E501
    device = torch.device("cuda" if case.backend in ("cuda", *PEERS) else "cpu")
    on_gpu = device.type == "cuda"
    before = _device_bytes() if on_gpu else 0
    work = work_of(case, _workload(case, run, device))
    if on_gpu:
        torch.cuda.reset_peak_memory_stats()
    times = [time_work(call, device, repeats, SECONDS_PER_CASE / len(work.calls)) for call in work.calls]
    peak = torch.cuda.max_memory_allocated() - before if on_gpu else None
    hits = None if work.hits is None else float(work.hits.double().mean())
    return {
        **asdict(case),
        "median_ms": float(np.mean([each.median_ms for each in times])),
        "spread_ms": float(np.mean([each.spread_ms for each in times])),
        "repeats": min(len(each.all_ms) for each in times),
        **{"hits_per_ray": hits, "alpha": work.alpha, "peak_bytes": peak},
        "bytes_per_primitive": peak / work.primitives if peak is not None and work.primitives else None,
        **_distribution("hits", work.hits),
        **_distribution("lists", work.lists),
    }


def _device_bytes() -> int:
    """What a GPU's memory holds; what earlier cases left behind must not be there at one time and gone at another."""
    gc.collect()
    return torch.cuda.memory_allocated()


def _workload(case: Case, run: TimedRun | None, device: torch.device) -> Workload:
    if case.scene == ROOM:
        return RoomWorkload(case, device)
    assert run is not None
    from .run_workload import RunWorkload  # and all that opens runs, which a room does without

    return RunWorkload(run, device)


def _distribution(name: str, counts: Tensor | None) -> dict[str, float | None]:
    """Median, 99th percentile and maximum."""
    keys = [f"{name}_p50", f"{name}_p99", f"{name}_max"]
    if counts is None or not len(counts):
        return dict.fromkeys(keys)
    return dict(zip(keys, np.percentile(counts.cpu().numpy(), [50, 99, 100]).tolist(), strict=True))
