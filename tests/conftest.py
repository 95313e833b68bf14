"""Fixtures that several test files share."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from backends import EMULATED, usable
from core_scenes import Backend
from cuda_emulator.emulator import emulated, find_compiler


def pytest_collection() -> None:
    gc.disable()


def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: the garbage collector need not look through it each time."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def emulate(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Backend]]:
    """emulate(order): from here to the test's end, the CUDA backend runs on the CPU, its threads in that order."""
    if find_compiler() is None:
        pytest.skip("the CUDA kernels' emulation needs a C++20 compiler: install g++, or set CXX")
    builds = request.config.cache.mkdir("cuda_emulator")
    with ExitStack() as stack:
        yield lambda order: stack.enter_context(emulated(builds, order))


@pytest.fixture(params=["cpu", "cuda", "torch", EMULATED])
def rasterizer(request: pytest.FixtureRequest) -> Backend:
    return usable(request)


@pytest.fixture(params=["cpu", "cuda", "torch", "embree", EMULATED])
def tracer(request: pytest.FixtureRequest) -> Backend:
    return usable(request)


@pytest.fixture(params=["cpu", "cuda", EMULATED])
def native(request: pytest.FixtureRequest) -> Backend:
    """The backends that are fast, in float32, and held against the oracle; emulated kernels are not fast."""
    return usable(request)
