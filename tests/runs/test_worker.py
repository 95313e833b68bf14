"""What the worker makes of an exception."""

from __future__ import annotations

import pytest
import torch

from envgs_bench.runs import worker
from envgs_bench.stages.health import Diverged


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (worker.TimeUp(), "timeout"),
        (KeyboardInterrupt(), "interrupted"),
        (BrokenPipeError(), "interrupted"),
        (Diverged(), "diverged"),
        (MemoryError(), "out_of_memory"),
        (torch.OutOfMemoryError("CUDA out of memory"), "out_of_memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), "out_of_memory"),
        (RuntimeError("shapes differ"), "failed"),
        (SystemExit(0), "failed"),
    ],
)
def test_every_exception_has_a_status(error: BaseException, status: str) -> None:
    assert worker._status(error) == status
