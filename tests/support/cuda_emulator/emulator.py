"""The CUDA backend without a GPU: kernels compiled as C++, run thread by thread, launched by the backend's own Python.

Threads synchronize at barriers and at the operations of a warp as CUDA says. In between, their order is free: a kernel
that depends on it gives different results in different `ORDERS`. What cannot be seen here:
docs/notebook/2026-11-21-gpu-correctness.md.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache, partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from core_scenes import Backend
from torch import Tensor

from envgs_bench.core import backends, cuda
from envgs_bench.core.cuda import compiler, launch

ORDERS = ("ascending", "descending", "shuffled")  # as in emulator.cpp
HERE = Path(__file__).parent
KERNEL = re.compile(r'extern "C" __global__ void\s+(?:__launch_bounds__\([^)]*\)\s+)?(\w+)\(')
# the backend's modules that allocate or wait
MODULES = ("", ".bvh", ".normals", ".raster_pass", ".reflect", ".sorting", ".ssim", ".trace_pass")
# With AddressSanitizer's library loaded before Python, accesses past a tensor's end are errors too.
WATCHED = hasattr(ctypes.CDLL(None), "__asan_init")
CHECKS = ("alignment", "bounds", *(("address",) if WATCHED else ()))
FLAGS = (
    "-std=c++20", "-O1", "-fPIC", "-w",
    "-fno-strict-aliasing",  # kernels read structs as arrays of floats
    "-ffp-contract=off",
    "-U_FORTIFY_SOURCE",  # its longjmp refuses to leave a stack for another
)  # fmt: skip
DAY = 24 * 3600


@cache
def find_compiler() -> str | None:
    """A C++20 compiler, $CXX before others; None where there is none."""
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++"):
        if name and shutil.which(name):
            check = [name, "-std=c++20", "-fsyntax-only", "-x", "c++", "-"]
            text = "#include <bit>\n#include <concepts>\n#include <ucontext.h>\nint main() {}"
            if subprocess.run(check, input=text, text=True, capture_output=True).returncode == 0:
                return name
    return None


class EmulatedKernels:
    """Takes the place of `launch.Kernels`."""

    def __init__(
        self, sources: Sequence[str], device: torch.device, *, builds: Path, order: str, **macros: object
    ) -> None:
        definitions = tuple(sorted((name, str(value)) for name, value in macros.items()))
        self._library = load(tuple(sources), definitions, builds)
        self._order = ORDERS.index(order)

    def __call__(self, name: str, blocks: int, threads: int, *arguments: Tensor | int | float | None) -> None:
        signature = self._function(f"signature_{name}")().decode()
        passed = "".join(map(code_of, arguments))
        assert passed == signature, f"{name} takes parameters {signature}, launched with {passed}"
        if blocks == 0:
            return
        cells = [as_parameter(argument) for argument in arguments]
        addresses = (ctypes.c_void_p * len(cells))(*map(ctypes.addressof, cells))
        error = self._function(f"launch_{name}")(blocks, threads, self._order, addresses)
        assert error is None, f"{name}: {error.decode()}"

    def _function(self, name: str) -> Any:
        function = getattr(self._library, name)
        function.restype = ctypes.c_char_p
        return function


def code_of(argument: Tensor | int | float | None) -> str:
    """p, i or f, as in emulator.h."""
    return "p" if argument is None or isinstance(argument, Tensor) else "f" if isinstance(argument, float) else "i"


def as_parameter(argument: Tensor | int | float | None) -> Any:
    if isinstance(argument, Tensor):
        assert argument.is_contiguous()
        assert argument.device.type == "cpu"
        return ctypes.c_void_p(argument.data_ptr())
    if argument is None:
        return ctypes.c_void_p()
    return ctypes.c_float(argument) if isinstance(argument, float) else ctypes.c_int(argument)


@cache
def load(sources: tuple[str, ...], macros: tuple[tuple[str, str], ...], builds: Path) -> ctypes.CDLL:
    """The kernels of these files as a library, from `builds` where they were compiled before."""
    folder = folder_for_sources(builds)
    library = folder / ("-".join([*(Path(name).stem for name in sources), *(value for _, value in macros)]) + ".so")
    if not library.exists():
        kernels = [name for file in sources for name in KERNEL.findall((compiler.FOLDER / file).read_text())]
        includes = "\n".join(f'#include "{file}"' for file in sources)
        exports = "\n".join(f"EXPORT_KERNEL({name})" for name in kernels)
        unit = f'#include "emulator.h"\nnamespace {{\n{includes}\n}}\n{exports}\n'
        build(library, unit, [f"-D{name}={value}" for name, value in macros])
    return ctypes.CDLL(str(library))


def build(library: Path, unit: str, macros: list[str]) -> None:
    """Several processes may do this at once. The checks' library is left out: emulator.cpp has what they call."""
    scheduler = library.with_name("emulator.o")
    with tempfile.TemporaryDirectory(dir=library.parent) as name:
        source, kernels, finished = (Path(name) / file for file in ("unit.cpp", "unit.o", "finished"))
        if not scheduler.exists():
            compile_one(HERE / "emulator.cpp", finished)
            finished.replace(scheduler)
        source.write_text(unit)
        checks = [f"-fsanitize={','.join(CHECKS)}", "-fno-sanitize-recover=all"]
        compile_one(source, kernels, *checks, *macros)
        run([find_compiler(), "-shared", str(kernels), str(scheduler), "-o", str(finished)])
        finished.replace(library)


def compile_one(source: Path, target: Path, *options: str) -> None:
    folders = [f"-I{folder}" for folder in (HERE, compiler.FOLDER, compiler.FOLDER.parent)]
    run([find_compiler(), *FLAGS, *options, *folders, "-c", str(source), "-o", str(target)])


def run(command: list[Any]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr[:4000]}"


@cache
def folder_for_sources(builds: Path) -> Path:
    """Where what was compiled from the sources as they are now lies; what nothing used for a day is deleted."""
    files = [
        *compiler.FOLDER.glob("*.cu*"),
        *(compiler.FOLDER.parent / "kernels").glob("*.h"),
        *HERE.glob("emulator.*"),
    ]
    digest = hashlib.sha256(f"{find_compiler()} {CHECKS}".encode())
    for file in sorted(files):
        digest.update(file.name.encode() + file.read_bytes())
    folder = builds / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    folder.touch()
    for other in builds.iterdir():
        if other.stat().st_mtime < time.time() - DAY:
            shutil.rmtree(other, ignore_errors=True)
    return folder


class HostTorch:
    """`torch` as the backend's modules see it: there is no device to wait for, and fresh memory holds NaN and −1."""

    cuda = SimpleNamespace(
        device=lambda _: nullcontext(),
        is_current_stream_capturing=lambda: False,
        current_stream=lambda: SimpleNamespace(record_event=lambda: SimpleNamespace(synchronize=lambda: None)),
        get_device_properties=lambda _: SimpleNamespace(multi_processor_count=1),
        mem_get_info=lambda _: (1 << 30, 1 << 30),
        memory_reserved=lambda _: 0,
        memory_allocated=lambda _: 0,
    )

    def __getattr__(self, name: str) -> Any:
        return getattr(torch, name)

    def empty(self, *size: Any, pin_memory: bool = False, **options: Any) -> Tensor:
        return poisoned(torch.empty(*size, **options))

    def empty_like(self, other: Tensor) -> Tensor:
        return poisoned(torch.empty_like(other))


def poisoned(memory: Tensor) -> Tensor:
    return memory.fill_(torch.nan if memory.is_floating_point() else -1)


def load_backend(name: str, device: torch.device, dtype: torch.dtype) -> ModuleType:
    """The core's own, but that "cuda" takes tensors on the CPU."""
    return cuda if name == "cuda" else backends.load_backend(name, device, dtype)


@contextmanager
def emulated(builds: Path, order: str) -> Iterator[Backend]:
    """Within, backend "cuda" takes CPU tensors and launches emulated kernels, their threads in the given order."""
    modules = [importlib.import_module(f"{cuda.__name__}{name}") for name in MODULES]
    raster_pass, trace_pass = (modules[MODULES.index(name)] for name in (".raster_pass", ".trace_pass"))
    with pytest.MonkeyPatch.context() as patch:
        for name in ("rasterize", "trace"):
            patch.setattr(importlib.import_module(f"envgs_bench.core.{name}"), "load_backend", load_backend)
        patch.setattr(launch, "Kernels", partial(EmulatedKernels, builds=builds, order=order))
        for module in modules:
            patch.setattr(module, "torch", HostTorch())
        patch.setattr(raster_pass, "MIN_CAPACITY", 1 << 12)  # every place has a thread
        patch.setattr(raster_pass, "_latest_instances", {})
        patch.setattr(trace_pass, "_latest_pages", {})
        launch.kernels.cache_clear()
        try:
            yield Backend("cuda", torch.float32, "cpu")
        finally:
            launch.kernels.cache_clear()
