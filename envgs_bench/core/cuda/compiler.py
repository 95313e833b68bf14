"""From CUDA C++ to kernels, at first use: NVRTC through `cuda.core`, and a folder that remembers what it compiled."""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from envgs_bench.parts import OLDEST_GPU

FOLDER = Path(__file__).parent
_folder: Path | None = None
OPTIONS = {"std": "c++17", "ftz": True, "prec_div": False, "prec_sqrt": False}


def why_unavailable() -> str | None:
    """One sentence for the user, or None where CUDA kernels can be compiled and run."""
    if torch.version.cuda is None:
        return "this PyTorch was built without CUDA; install a CUDA build of torch"
    if not torch.cuda.is_available():
        return "PyTorch sees no CUDA device; check the driver with nvidia-smi"
    capability = torch.cuda.get_device_capability()
    if capability < OLDEST_GPU:
        has, needed = ("{}.{}".format(*pair) for pair in (capability, OLDEST_GPU))
        return f"the GPU has compute capability {has}, {needed} or newer is needed"
    try:
        cuda_core()
        from cuda.bindings import nvrtc

        nvrtc.nvrtcVersion()
    except Exception as error:  # a missing package, or a missing library deep inside one
        return f"CUDA C++ cannot be compiled ({error}); install with: pip install 'envgs-bench[cuda]'"
    return None


@cache
def compile_kernels(sources: tuple[str, ...], macros: tuple[tuple[str, str], ...], device: int) -> Any:
    """The `cuda.core.ObjectCode` of these files of this folder, compiled as one module for the device's architecture.

    Raises:
        RuntimeError: the compiler refused; the message is its log.
    """
    major, minor = torch.cuda.get_device_capability(device)
    architecture = f"sm_{major}{minor}"
    core = cuda_core()
    path = cache_dir() / f"{_key(sources, macros, architecture)}.cubin"
    known = remembered(path)
    if known is not None:
        return core.ObjectCode.from_cubin(known)
    text = "".join(f'#include "{name}"\n' for name in sources)
    options = core.ProgramOptions(
        arch=architecture,
        include_path=[str(FOLDER), str(FOLDER.parent)],
        define_macro=[f"{name}={value}" for name, value in macros] or None,
        **OPTIONS,
    )
    code = core.Program(text, "c++", options).compile("cubin")
    remember(path, code.code)
    return code


def cache_dir() -> Path:
    """Where `keep_kernels_in` says, or else $ENVGS_BENCH_CACHE/kernels, or else ~/.cache/envgs-bench/kernels."""
    if _folder is not None:
        return _folder
    return Path(os.environ.get("ENVGS_BENCH_CACHE") or "~/.cache/envgs-bench").expanduser() / "kernels"


def keep_kernels_in(folder: Path) -> None:
    """From now on this process looks for compiled kernels in `folder`, and puts them there."""
    global _folder
    _folder = folder


@cache
def cuda_core() -> ModuleType:
    core = importlib.import_module("cuda.core")
    return core if hasattr(core, "Program") else importlib.import_module("cuda.core.experimental")  # before version 1


def _key(sources: tuple[str, ...], macros: tuple[tuple[str, str], ...], architecture: str) -> str:
    """A hash of all that the machine code depends on."""
    from cuda.bindings import driver, nvrtc

    digest = hashlib.sha256()
    for value in (sources, macros, architecture, OPTIONS, nvrtc.nvrtcVersion(), driver.cuDriverGetVersion()):
        digest.update(repr(value).encode())
    for name, text in _texts().items():
        digest.update(name.encode())
        digest.update(text)
    return digest.hexdigest()[:32]


@cache
def _texts() -> Mapping[str, bytes]:
    files = sorted([*FOLDER.glob("*.cu"), *FOLDER.glob("*.cuh"), *(FOLDER.parent / "kernels").glob("*.h")])
    return {file.name: file.read_bytes() for file in files}


def remember(path: Path, code: bytes) -> None:
    """Keep machine code, with its hash before it.

    Several processes may do this at once. A folder that cannot be written to costs later processes time, no more.
    """
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent)
        try:
            with open(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(part, path)
        finally:
            Path(part).unlink(missing_ok=True)  # there only where it could not be finished


def remembered(path: Path) -> bytes | None:
    """What `remember` kept, None where there is nothing, or something that was damaged and is to be made again."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, code = content[:32], content[32:]
    return code if hashlib.sha256(code).digest() == digest else None
