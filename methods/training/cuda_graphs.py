"""Recording: work of a GPU recorded once as a CUDA graph, and what it must not meet meanwhile."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import TypeVar

import torch

SPARE_SHARE = 1 / 32  # of a GPU's memory, that torch may keep for nothing: sizes change with each recording

Result = TypeVar("Result")


def recorded(work: Callable[[], Result], device: torch.device) -> tuple[torch.cuda.CUDAGraph, Result]:
    """The graph of what `work` launches, which does not run yet, and what it returns: replays write into that.

    `work` must not wait for the device, has been done before, so that its kernels are compiled, and is called
    within `on_own_stream`.
    """
    _give_back_spare(device)
    graph = torch.cuda.CUDAGraph()
    with _no_collection():
        # Without torch.cuda.graph(), which empties the allocator's caches and so waits for the device.
        graph.capture_begin(capture_error_mode="thread_local")
        try:
            result = work()
        except BaseException:
            with suppress(RuntimeError):  # that the recording is none: why, is what is being raised
                graph.capture_end()
            raise
        graph.capture_end()
    return graph, result


@contextmanager
def on_own_stream(device: torch.device) -> Iterator[None]:
    """What is launched in here comes after what the caller has launched and before what the caller launches next.

    It goes to a stream of its own, on a CPU nowhere else. The default stream cannot be recorded, and a gradient is
    handed to a parameter on the stream on which the parameter was first used: for as long as some thread of autograd's
    holds on to that, a recording on another stream would drag the first one in, and fail.
    """
    if device.type != "cuda":
        yield
        return
    outside, stream = torch.cuda.current_stream(device), _own_stream(device)
    if outside == stream:
        yield
        return
    stream.wait_stream(outside)
    try:
        with torch.cuda.stream(stream):
            yield
    finally:
        outside.wait_stream(stream)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Python collects no garbage in here: freeing another graph, or what is mapped for it, would end a recording."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _give_back_spare(device: torch.device) -> None:
    """Leave a GPU's memory to others that share it: what earlier recordings took, torch does not reuse for the next."""
    spare = SPARE_SHARE * torch.cuda.get_device_properties(device).total_memory
    if torch.cuda.memory_reserved(device) > spare + torch.cuda.memory_allocated(device):
        torch.cuda.empty_cache()


@cache
def _own_stream(device: torch.device) -> torch.cuda.Stream:
    return torch.cuda.Stream(device)
