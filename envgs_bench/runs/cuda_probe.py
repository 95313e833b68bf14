"""Probe: which GPUs a run can surely use, asked of NVIDIA's driver by a process of its own, without PyTorch.

`python -m envgs_bench.runs.cuda_probe` prints one JSON object; where anything is amiss it fails, and prints none. A
process that has asked the driver can fork none that uses a GPU.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import json
import os
import runpy
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from envgs_bench.parts import OLDEST_GPU

VISIBLE = "CUDA_VISIBLE_DEVICES"
DRIVER = "libcuda.so.1"
CAPABILITY = (75, 76)  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR and _MINOR of the driver API
SECONDS = 30.0  # time limit: a driver that nobody uses takes several to wake up


def has_driver() -> bool:
    """Whether there is a driver at all; without one PyTorch sees no CUDA device."""
    with suppress(OSError):
        return bool(ctypes.CDLL(DRIVER))
    return False


def surely_usable() -> int:
    """How many GPUs there are that PyTorch sees and the cuda backend works on; 0 where PyTorch itself has to say."""
    return _asked(os.environ.get(VISIBLE)) if has_driver() else 0


def begin() -> None:
    """Have the driver, which is there, asked while this process does something else: its answer then takes less."""
    _probe(os.environ.get(VISIBLE))


@cache  # a probe for each choice of what may be seen
def _probe(visible: str | None) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


@cache
def _asked(visible: str | None) -> int:
    probe = _probe(visible)
    try:
        answer, _ = probe.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        probe.kill()
        return 0
    with suppress(OSError, ValueError, KeyError, TypeError):
        found = json.loads(answer)
        if tuple(found["capability"]) >= OLDEST_GPU and found["cuda"] >= _cuda_of_torch():
            return int(found["gpus"])
    return 0


def _cuda_of_torch() -> list[int]:
    """The major version of CUDA that PyTorch was built for, of which a driver runs any minor one.

    Raises:
        KeyError, ValueError: it cannot be told, or PyTorch was built without.
    """
    spec = importlib.util.find_spec("torch")
    version = runpy.run_path(str(Path(spec.origin).with_name("version.py")))["cuda"] if spec and spec.origin else ""
    return [int(str(version).partition(".")[0])]


def shown_by(driver: Any) -> dict[str, Any]:
    """What the driver shows: `gpus`, their number; `capability`, the first one's; `cuda`, the newest that it runs.

    Args:
        driver: libcuda, as ctypes loads it.

    Raises:
        RuntimeError: one of its functions failed, as where there is no GPU; the message is its CUresult.
    """
    _require(driver.cuInit(0))
    first = _number(driver.cuDeviceGet, 0)
    newest = _number(driver.cuDriverGetVersion)  # 1000·major + 10·minor
    return {
        "gpus": _number(driver.cuDeviceGetCount),
        "capability": [_number(driver.cuDeviceGetAttribute, which, first) for which in CAPABILITY],
        "cuda": [newest // 1000, newest % 1000 // 10],
    }


def _number(function: Callable[..., int], *given: int) -> int:
    """The int that the function writes to where its first argument points."""
    found = ctypes.c_int()
    _require(function(ctypes.byref(found), *given))
    return found.value


def _require(result: int) -> None:
    if result:
        raise RuntimeError(f"CUresult {result}")


if __name__ == "__main__":
    importlib.import_module("cuda.core")
    importlib.import_module("cuda.bindings.nvrtc").nvrtcVersion()
    print(json.dumps(shown_by(ctypes.CDLL(DRIVER))))
