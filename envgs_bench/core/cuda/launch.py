"""Launching kernels on torch's current stream."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from .compiler import compile_kernels, cuda_core
from .layout import CONSTANTS


class Kernels:
    """The kernels of a compiled module: `kernels(name, blocks, threads, *arguments)` launches one.

    Arguments follow the kernel's parameters: a contiguous tensor or None for a pointer, int, bool and float for 32-bit
    scalars. Nothing waits for the device.
    """

    def __init__(self, sources: Sequence[str], device: torch.device, **macros: object) -> None:
        index = torch.cuda.current_device() if device.index is None else device.index
        definitions = tuple(sorted((name, str(value)) for name, value in macros.items()))
        self._device = index
        self._code = compile_kernels(tuple(sources), definitions, index)
        self._kernels: dict[str, Any] = {}

    def __call__(self, name: str, blocks: int, threads: int, *arguments: Tensor | int | float | None) -> None:
        if blocks == 0:
            return
        kernel = self._kernels.get(name)
        if kernel is None:
            kernel = self._kernels[name] = self._code.get_kernel(name)
        # The raw handle: torch.cuda.current_stream() builds objects, which takes longer than the launch.
        stream = _stream(torch._C._cuda_getCurrentRawStream(self._device))
        cuda_core().launch(stream, _shape(blocks, threads), kernel, *(_AS_ARGUMENT[type(x)](x) for x in arguments))


@lru_cache(maxsize=64)
def kernels(sources: tuple[str, ...], device: torch.device, **macros: object) -> Kernels:
    """The same Kernels for the same request; besides `macros` they see layout.py's constants."""
    return Kernels(sources, device, **CONSTANTS, **macros)


def blocks_for(items: int, threads: int) -> int:
    return -(-items // threads)


def zeroed(device: torch.device, *sizes: int) -> list[Tensor]:
    """int32 tensors of these sizes, zero, in one allocation; each begins at 16 bytes."""
    padded = [-(-size // 4) * 4 for size in sizes]
    whole = torch.zeros(sum(padded), dtype=torch.int32, device=device)
    return [part[:size] for part, size in zip(whole.split(padded), sizes, strict=True)]


def aligned(tensor: Tensor) -> Tensor:
    """The tensor, or a copy that begins at 16 bytes: kernels read rows as vectors."""
    return tensor.clone() if tensor.data_ptr() % 16 else tensor


# By exact type: a launch has some twenty arguments, and its time on the host is what small images cost.
_AS_ARGUMENT: dict[type, Callable[[Any], Any]] = {
    Tensor: Tensor.data_ptr,
    int: ctypes.c_int,
    bool: ctypes.c_int,
    float: ctypes.c_float,
    type(None): lambda _: 0,
}


@lru_cache(maxsize=4096)
def _shape(blocks: int, threads: int) -> Any:
    return cuda_core().LaunchConfig(grid=blocks, block=threads)


@lru_cache(maxsize=64)
def _stream(handle: int) -> Any:
    return cuda_core().Stream.from_handle(handle)
