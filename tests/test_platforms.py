"""Systems without fcntl, SIGALRM and the like (Windows, in part macOS) import what this one does."""

from __future__ import annotations

import subprocess
import sys

# What Windows' Python lacks is taken away once the libraries are there that need it on this system.
WITHOUT = """
import importlib, os, signal, sys
import hydra, pandas, psutil, rich.console, torch
for name in ("fcntl", "resource", "pwd", "termios"):
    sys.modules[name] = None
for owner, names in ((signal, ("SIGALRM", "ITIMER_REAL", "setitimer", "SIGKILL")),
                     (os, ("O_NOFOLLOW", "O_NONBLOCK", "killpg", "getuid", "getppid", "pread", "set_blocking"))):
    for name in names:
        if hasattr(owner, name):
            delattr(owner, name)
for module in ("run_lock", "cli.main", "cli.run", "runs.gpus", "runs.processes", "runs.process", "runs.worker",
               "runs.job", "stages.execution", "stages.stop", "cli.application"):
    importlib.import_module(f"envgs_bench.{module}")
from envgs_bench.file_lock import lock
try:
    lock(0)
except OSError as error:
    print(error)
"""


def test_imports_need_nothing_that_other_systems_lack() -> None:
    result = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "runs need file locks as of Linux or macOS" in result.stdout
