"""Commands of another program: every way to end is told apart, and nothing is left running."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from envgs_bench.programs import command
from envgs_bench.programs.command import ProgramFailed, environment_on, run_command
from envgs_bench.programs.isolation import Started, isolated
from envgs_bench.programs.memory import MemoryWatch, ProgramOutOfMemory
from envgs_bench.programs.recipe import Isolation


def watch(host_gb: float | None = None) -> MemoryWatch:
    return MemoryWatch("cpu", host_gb, None)


def python(code: str) -> Started:
    return Started([sys.executable, "-c", code])


def run_python(code: str, folder: Path) -> list[str]:
    """The lines that it printed."""
    lines: list[str] = []
    run_command(python(code), folder, watch(), lines.append)
    return lines


def wait_for_the_end_of(pid: int) -> None:
    deadline = time.monotonic() + 5
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_lines_end_where_a_progress_bar_goes_back(tmp_path: Path) -> None:
    code = r"import sys; sys.stdout.write('1\r2\r3\n'); sys.stderr.write('4'); sys.stdout.buffer.write(b'\xff\n')"
    lines = run_python(code, tmp_path)
    assert lines[:3] == ["1", "2", "3"] or "4" in lines[0]
    assert any("\ufffd" in line for line in lines)


@pytest.mark.parametrize(
    ("code", "error", "message"),
    [
        ("import sys; print('no license'); sys.exit(3)", ProgramFailed, "ended with exit status 3.*no license"),
        ("raise RuntimeError('mood')", ProgramFailed, "ended with exit status 1.*RuntimeError: mood"),
        ("import os; os.kill(os.getpid(), 11)", ProgramFailed, "died of SIGSEGV.*it printed nothing"),
        ("import os; os.kill(os.getpid(), 9)", ProgramOutOfMemory, r"was killed \(SIGKILL\)"),
        ("raise MemoryError", ProgramOutOfMemory, "out of memory"),
        ("raise SystemExit('CUDA out of memory. Tried …')", ProgramOutOfMemory, "out of memory"),
    ],
)
def test_a_failure_says_how_and_what_was_printed(
    tmp_path: Path, code: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=re.compile(message, re.DOTALL)):
        run_python(code, tmp_path)


def test_words_on_memory_alone_are_no_failure(tmp_path: Path) -> None:
    assert run_python("print('never out of memory')", tmp_path) == ["never out of memory"]


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProgramFailed, match="no-such-trainer: there is no such program on the PATH"):
        run_command(Started(["no-such-trainer", "--data"]), tmp_path, watch())


def test_what_it_started_ends_with_it(tmp_path: Path) -> None:
    code = "import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(99)'])"
    (line,) = run_python(f"{code}; print(p.pid)", tmp_path)
    wait_for_the_end_of(int(line))


def test_whatever_is_raised_while_it_runs_ends_it_and_what_left_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "GRACE_SECONDS", 0.3)
    code = (
        "import signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
        "p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(99)'], start_new_session=True);"
        "print(p.pid, flush=True); time.sleep(99)"
    )
    found, ready = [], threading.Event()

    def listen(line: str) -> None:
        found.append(int(line))
        ready.set()

    def tell() -> None:
        if ready.is_set() and not psutil.Process(os.getpid()).children() == []:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_command(python(code), tmp_path, watch(), listen, tell)
    wait_for_the_end_of(found[0])


def test_memory_of_all_that_it_started_counts(tmp_path: Path) -> None:
    inner = "import os, time; held = os.urandom(1 << 20) * 200; print(len(held), flush=True); time.sleep(1)"
    looked = watch()
    run_command(python(f"import subprocess, sys; subprocess.run([sys.executable, '-c', {inner!r}])"), tmp_path, looked)
    assert looked.peak_host_bytes is not None
    assert 200 << 20 <= looked.peak_host_bytes < 300 << 20
    assert looked.peak_device_bytes is None


def test_more_memory_than_it_may_have_ends_it(tmp_path: Path) -> None:
    code = "import os, time; held = os.urandom(1 << 20) * 300; time.sleep(60)"
    with pytest.raises(ProgramOutOfMemory, match=r"held 0\.\d+ GiB, memory_gb=0\.2"):
        run_command(python(code), tmp_path, watch(0.2))


def test_isolations_are_what_their_tools_want() -> None:
    def started(**isolation: str) -> Started:
        return isolated(["train", "-x"], Isolation(**isolation), {"A": "1"}, [Path("/data"), Path("/home/p")], "name")

    assert started() == Started(["train", "-x"], {"A": "1"})
    venv = started(kind="venv", name="/opt/v")
    assert venv.words == ["train", "-x"]
    assert venv.environment["PATH"].startswith("/opt/v/bin:")
    assert started(kind="conda", name="e").words == ["conda", "run", "--no-capture-output", "-n", "e", "train", "-x"]
    docker = started(kind="docker", name="image:1", options="--gpus all")
    assert " ".join(docker.words) == (
        "docker run --rm --init --name name -v /data:/data -v /home/p:/home/p -e A=1 --gpus all image:1 train -x"
    )
    assert docker.container == ("docker", "name")
    apptainer = started(kind="apptainer", name="a.sif", options="--nv")
    assert " ".join(apptainer.words) == "apptainer exec --bind /data,/home/p --nv a.sif train -x"


def test_a_program_on_the_cpu_sees_no_gpu() -> None:
    assert environment_on("cpu", {"B": "2"}) == {"CUDA_VISIBLE_DEVICES": "", "PYTHONUNBUFFERED": "1", "B": "2"}
    assert "CUDA_VISIBLE_DEVICES" not in environment_on("cuda", {})
