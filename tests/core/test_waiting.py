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


FEW_THREADS = """
import resource, torch
import envgs_bench.core
torch.set_num_threads(1)
taken = next(int(line.split()[1]) << 10 for line in open("/proc/self/status") if line.startswith("VmSize"))
resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, taken + ROOM))
from envgs_bench.core import cpu
print(cpu.why_unavailable())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="Linux's limits")
@pytest.mark.parametrize("stacks", [0.5, 2.5])  # of too little memory for the first thread, and for the third
def test_a_process_that_may_start_no_threads_can_load_the_backend(stacks: float) -> None:
    """GNU's OpenMP ends a process that asks for more threads than it is given."""
    stack = 1 << 30
    program = FEW_THREADS.replace("ROOM", str(int(stacks * stack)))
    environment = {name: value for name, value in os.environ.items() if name not in native.WAITING}
    limited = ["bash", "-c", f'ulimit -S -s {stack >> 10} && exec "$@"', "bash", sys.executable, "-c", program]
    run = subprocess.run(limited, env=environment, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "None\n"), run.stderr
