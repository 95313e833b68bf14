"""Provenance: which code computed a result, with which packages, on which machine, and who else was using it."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import time
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

if TYPE_CHECKING:  # a job notes when its run began without torch, and collects the rest only where that died
    import torch

PACKAGE = "envgs-bench"

Busy = tuple[float, float, float]  # seconds on the wall, of all cores' work, of this process's and its ended children's

# Those whose version can change a result or a time.
PACKAGES = (
    "torch",
    "numpy",
    "scipy",
    "kornia",
    "scikit-image",
    "pillow",
    "torchmetrics",
    "embreex",
    "pycolmap",
    "hydra-core",
    "cuda-core",
)

COMMAND_SECONDS = 5.0  # time limit of git and nvidia-smi

GPU_FIELDS = {
    "clock_mhz": "clocks.sm",
    "clock_max_mhz": "clocks.max.sm",
    "memory_clock_mhz": "clocks.mem",
    "power_limit_w": "power.limit",
}


def collect(device: str, since: Busy) -> dict[str, Any]:
    """What there is to know, as plain JSON values; whatever cannot be found out is None.

    Args:
        device: where the method ran, "cpu", "cuda" or "cuda:<index>".
        since: `busy()` of when the run began.

    Returns:
        version, python, platform, packages, machine, device, threads, command.
    """
    import torch

    return {
        "version": _version(PACKAGE) or "not installed",
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
        "machine": _machine(since),
        "device": _gpu(torch.device(device)) if device.startswith("cuda") else {"type": "cpu", "name": _cpu_model()},
        "threads": torch.get_num_threads(),
        "command": shlex.join(sys.orig_argv),
    }


def _machine(since: Busy) -> dict[str, Any]:
    from envgs_bench.core import cpu

    return {
        "cpu": _cpu_model(),
        "cpu_target": cpu.target,
        "cores": psutil.cpu_count(logical=False),
        "logical_cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_bytes": psutil.virtual_memory().total,
        "others_cores": _others_cores(since),
    }


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _gpu(device: torch.device) -> dict[str, Any]:
    import torch

    properties = torch.cuda.get_device_properties(device)
    found: dict[str, Any] = {
        "type": "cuda",
        "name": properties.name,
        "memory_bytes": properties.total_memory,
        "compute_capability": f"{properties.major}.{properties.minor}",
        "multiprocessors": properties.multi_processor_count,
        "cuda": torch.version.cuda,
    }
    query = ["nvidia-smi", f"--id=GPU-{properties.uuid}", "--format=csv,noheader,nounits"]
    row = _output([*query, f"--query-gpu=driver_version,{','.join(GPU_FIELDS.values())}"])
    driver, *values = row.split(",") if row else [None] * (1 + len(GPU_FIELDS))
    found |= {"driver": driver, **{key: _number(value) for key, value in zip(GPU_FIELDS, values, strict=True)}}
    pids = _output([*query, "--query-compute-apps=pid"])
    # Containers show no processes, or other numbers than the process itself sees: only their count can be trusted.
    found["shared"] = len(pids.split()) > 1 if pids else None
    return found


@cache
def checkout() -> dict[str, Any]:
    """`commit` of the checkout that this file is tracked in, and whether tracked files differ from it: `dirty`.

    Both None outside of a checkout. As it was when this was asked for first, in this process or the one that it was
    forked from, which is when the code was read: somebody may commit before a run ends.
    """
    here = Path(__file__).resolve()
    git = ["git", "-C", str(here.parent)]
    if not _output([*git, "ls-files", here.name]):
        return {"commit": None, "dirty": None}  # an installed copy, perhaps inside somebody else's checkout
    commit = _output([*git, "rev-parse", "HEAD"])
    changes = _output([*git, "status", "--porcelain", "--untracked-files=no"])
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _output(command: list[str]) -> str | None:
    """What a command prints, stripped; None where it is missing, fails or takes too long."""
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_SECONDS, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return result.stdout.strip()


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:  # "[N/A]"
        return None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def busy() -> Busy:
    """Of this moment."""
    cores, own = psutil.cpu_times(), psutil.Process().cpu_times()
    all_work = cores.user + cores.system + getattr(cores, "nice", 0.0)
    mine = own.user + own.system + getattr(own, "children_user", 0.0) + getattr(own, "children_system", 0.0)
    return time.perf_counter(), all_work, mine


def _others_cores(since: Busy) -> float | None:
    """How many cores others kept busy, on average. 0 means the machine was ours."""
    wall, all_work, mine = (now - then for now, then in zip(busy(), since, strict=True))
    return round(max(0.0, all_work - mine) / wall, 2) if wall > 1 else None  # the system counts in steps of 10 ms
