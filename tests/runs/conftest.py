"""Fixtures of the tests of runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from fakes.runs import CONF, QUICK, environment, run_job_here, set_environment
from fakes.whole_sweeps import Start, alive


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts a sweep in a process group of its own, as a shell does; what is left of it is killed in the end."""
    started = []

    def start(*overrides: str, pipe: str = "") -> subprocess.Popen[str]:
        sweep = [sys.executable, "-m", "envgs_bench.cli.main", "run", "--config-dir", str(CONF), "-m", *QUICK]
        command = " ".join([*sweep, "runs_dir=runs", *overrides, pipe])
        started.append(
            subprocess.Popen(
                ["bash", "-c", f"set -o pipefail; {command}"],
                cwd=tmp_path,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
                env={**os.environ, **environment()},
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
            )
        )
        return started[-1]

    yield start
    for process in started:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    for process in alive(tmp_path):
        process.kill()


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A runs_dir with one finished run, of no overrides, to be copied."""
    runs_dir = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        assert run_job_here(runs_dir) == 0
    return runs_dir
