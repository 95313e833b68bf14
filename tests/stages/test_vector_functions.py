"""The same numbers in every fresh process, from the first call on."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROCESSES = 1000

# Each child is a copy of a process that has loaded PyTorch and called nothing, which is far quicker than loading it.
SCRIPT = f"""
import os
import torch
from envgs_bench.stages.vector_functions import call_each_once

def child():
    call_each_once()
    torch.set_num_threads(2)
    values = torch.linspace(0.01, 1, 200_000)
    for name in ("log", "exp", "sigmoid", "log10"):
        function = getattr(torch, name)
        if not torch.equal(function(values), function(values)):
            os._exit(1)
    os._exit(0)

wrong = 0
for _ in range({PROCESSES}):
    pid = os.fork()
    if pid == 0:
        child()
    wrong += os.waitpid(pid, 0)[1] != 0
print(wrong)
"""


@pytest.mark.slow
def test_the_first_call_of_a_thousand_fresh_processes_is_right() -> None:
    result = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert int(result.stdout) == 0
