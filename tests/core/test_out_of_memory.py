"""Memory that runs out in the CPU backend's threads is a MemoryError, not the end of the process."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COUNT, THREADS, ROOM = 200_000, 4, 40 << 20
# Each thread of a backward pass adds up gradients of all primitives, 18 MB and more; torch asks for 16 MB before. The
# small drawing starts the threads, for which there might be no room left. What glibc holds ready for threads would be
# room without a limit.
GLIBC = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": "131072"}
PROGRAM = f"""
import resource, torch
from envgs_bench.core import Camera, GaussianSet, rasterize, trace
torch.set_num_threads({THREADS})
camera = Camera(torch.eye(4), torch.tensor([[20.0, 0, 10], [0, 20.0, 10], [0, 0, 1]]), 20, 20)
def loss(count):
    means = (torch.rand(count, 3) + torch.tensor([-0.5, -0.5, 4])).requires_grad_()
    sizes = torch.full((count, 2), 0.01), torch.full((count,), 0.5)
    surfels = GaussianSet(means, torch.ones(count, 4), *sizes, torch.ones(count, 1, 3))
    drawn = rasterize(surfels, camera) if DRAWS else trace(surfels, torch.zeros(9, 3), torch.rand(9, 3))
    return drawn.color.sum()
loss(100).backward()
large = loss({COUNT})
taken = next(int(line.split()[1]) << 10 for line in open("/proc/self/status") if line.startswith("VmSize"))
resource.setrlimit(resource.RLIMIT_AS, (taken + {ROOM}, taken + {ROOM}))
try:
    large.backward()
except MemoryError:
    print("MemoryError")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="Linux's limits")
@pytest.mark.parametrize("draws", [True, False], ids=["image", "rays"])
def test_a_backward_pass_without_room(draws):
    program = PROGRAM.replace("DRAWS", str(draws))
    run = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | GLIBC, capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stdout) == (0, "MemoryError\n"), run.stderr
