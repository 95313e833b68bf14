"""Threads that wait for others sleep, in whatever order libraries were imported: beside other programs they must."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from envgs_bench.core.cpu import native

PAUSES, SECONDS = 200, 0.001
PROGRAM = f"""
import time, torch
from envgs_bench.core import cpu
torch.set_num_threads(2)
numbers = torch.rand(200_000)
time.sleep(0.2)
began = time.process_time()
for _ in range({PAUSES}):
    numbers.add_(1)
    time.sleep({SECONDS})
print(time.process_time() - began)
"""


@pytest.mark.slow
def test_threads_sleep_between_parallel_loops():
    """Spinning, the second thread would be busy all through the pauses: 0.2 s of the processor's time and more."""
    environment = {name: value for name, value in os.environ.items() if name not in native.WAITING}
    printed = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert float(printed) < 0.5 * PAUSES * SECONDS
