"""Launching kernels on torch's current stream."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from .compiler import _cuda_core, compile_kernels


class Kernels:
    """The kernels of a compiled module: `kernels(name, blocks, threads, *arguments)` launches one.

    Arguments follow the kernel's parameters: a contiguous tensor or None for a pointer, int, bool and float for 32-bit
    scalars. Nothing waits for the device.
    """

    def __init__(self, sources: Sequence[str], device: torch.device, **macros: object) -> None:
        index = torch.cuda.current_device() if device.index is None else device.index
        definitions = tuple(sorted((name, str(value)) for name, value in macros.items()))
        self._code = compile_kernels(tuple(sources), definitions, index)
        self._kernels: dict[str, Any] = {}

    def __call__(self, name: str, blocks: int, threads: int, *arguments: Tensor | int | float | None) -> None:
        if blocks == 0:
            return
        kernel = self._kernels.get(name)
        if kernel is None:
            kernel = self._kernels[name] = self._code.get_kernel(name)
        core = _cuda_core()
        stream = _stream(torch.cuda.current_stream().cuda_stream)
        core.launch(stream, core.LaunchConfig(grid=blocks, block=threads), kernel, *map(_argument, arguments))


@lru_cache(maxsize=64)
def kernels(sources: tuple[str, ...], device: torch.device, **macros: object) -> Kernels:
    """The same Kernels for the same request."""
    return Kernels(sources, device, **macros)


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


def _argument(value: Tensor | int | float | None) -> Any:
    if isinstance(value, Tensor):
        return value.data_ptr()
    if value is None:
        return 0
    return ctypes.c_float(value) if isinstance(value, float) else ctypes.c_int(value)


@lru_cache(maxsize=64)
def _stream(handle: int) -> Any:
    return _cuda_core().Stream.from_handle(handle)
