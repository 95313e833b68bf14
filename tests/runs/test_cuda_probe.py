"""Which GPUs a run can surely use is told without PyTorch, by a driver that stands in for NVIDIA's, and by PyTorch."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from envgs_bench.core import available_backends
from envgs_bench.runs import cuda_probe

# Two GPUs of capability 9.0, or MAJOR.0; CUDA_VISIBLE_DEVICES=1 hides one. The driver runs CUDA up to 13.1.
DRIVER = """
#include <stdlib.h>
#include <string.h>
static int shown(void) { const char *v = getenv("CUDA_VISIBLE_DEVICES"); return !v ? 2 : strcmp(v, "1") ? 0 : 1; }
int cuInit(unsigned flags) { return flags ? 1 : shown() ? 0 : 100; }
int cuDeviceGetCount(int *count) { *count = shown(); return 0; }
int cuDeviceGet(int *device, int ordinal) { *device = ordinal; return ordinal < shown() ? 0 : 101; }
static int major(void) { const char *v = getenv("MAJOR"); return v ? atoi(v) : 9; }
int cuDeviceGetAttribute(int *value, int which, int device) { *value = which == 75 ? major() : 0; return device; }
int cuDriverGetVersion(int *version) { *version = 13010; return 0; }
"""
ASK = "from envgs_bench.runs.cuda_probe import has_driver, surely_usable; print(has_driver(), surely_usable())"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with that driver and the packages that are looked for: a torch that must not be imported among them."""
    folder = tmp_path_factory.mktemp("machine")
    (folder / "driver.c").write_text(DRIVER)
    compiler_here = os.environ.get("CC", "cc")
    if not shutil.which(compiler_here):
        pytest.skip("the driver that stands in needs a C compiler: install one, or set CC")
    built = [compiler_here, "-shared", "-fPIC", "-o", folder / cuda_probe.DRIVER, folder / "driver.c"]
    subprocess.run(built, check=True)
    files = {
        "torch/__init__.py": "raise AssertionError",
        "cuda/__init__.py": "",  # so that no package of that name that is installed is found beside it
        "cuda/core/__init__.py": "",
        "cuda/bindings/nvrtc.py": "def nvrtcVersion(): pass",
    }
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder


def called(machine: Path, cuda: str | None, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Python, called there, with a PyTorch that was built for this version of CUDA."""
    (machine / "torch/version.py").write_text(f"cuda = {cuda!r}")
    kept = {name: value for name, value in os.environ.items() if name != cuda_probe.VISIBLE}
    paths = {"LD_LIBRARY_PATH": str(machine), "PYTHONPATH": str(machine), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run([sys.executable, *arguments], env=kept | paths | variables, capture_output=True, text=True)


def asked(machine: Path, cuda: str | None, **variables: str) -> str:
    """Whether there is a driver, and how many GPUs can be used."""
    done = called(machine, cuda, "-c", ASK, **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux'")
def test_gpus_are_counted_where_the_driver_runs_what_pytorch_was_built_for(machine: Path) -> None:
    assert asked(machine, "13.0") == asked(machine, "12.8") == "True 2"
    assert asked(machine, "13.2") == "True 2"  # drivers run every minor version of theirs
    assert asked(machine, "13.0", CUDA_VISIBLE_DEVICES="1") == "True 1"
    assert [asked(machine, "13.0", MAJOR=major) for major in ("7", "8", "12")] == ["True 0", "True 2", "True 2"]
    for cuda, visible in (("14.0", "1"), (None, "1"), ("13.0", ""), ("13.0", "-1")):
        assert asked(machine, cuda, CUDA_VISIBLE_DEVICES=visible) == "True 0"


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux'")
def test_pytorch_has_to_say_where_kernels_cannot_be_compiled(machine: Path) -> None:
    (machine / "cuda/bindings/nvrtc.py").rename(machine / "cuda/bindings/none.py")
    assert asked(machine, "13.0") == "True 0"
    (machine / "cuda/bindings/none.py").rename(machine / "cuda/bindings/nvrtc.py")


@pytest.mark.skipif(sys.platform != "linux", reason="the driver's name is Linux'")
def test_a_run_on_a_gpu_is_planned_without_pytorch(machine: Path, tmp_path: Path) -> None:
    planned = ["-m", "envgs_bench.cli.main", "run", "--dry-run", "dataset=toy/chrome_room", f"runs_dir={tmp_path}"]
    done = called(machine, "13.0", *planned, f"cache_dir={tmp_path}")
    assert (done.returncode, "1 to run" in done.stdout) == (0, True), done.stderr
    done = called(machine, "13.0", *planned, "device=cuda:2")
    assert "device=cuda:2: this machine shows 2 GPUs, the last one is cuda:1" in done.stderr


def test_the_answer_here_is_pytorchs() -> None:
    if torch.cuda.is_available() and available_backends()["cuda"] is None:
        assert cuda_probe.surely_usable() == torch.cuda.device_count()
    else:
        assert cuda_probe.surely_usable() == 0
    assert cuda_probe.has_driver() or not torch.cuda.is_available()
