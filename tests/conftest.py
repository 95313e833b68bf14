"""Fixtures that several test files share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from core_scenes import Backend
from cuda_emulator.emulator import emulated, find_compiler

EMULATED = pytest.param("emulated", marks=pytest.mark.slow)  # the CUDA backend's kernels, without a GPU


@pytest.fixture
def emulate(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Backend]]:
    """emulate(order): from here to the test's end, the CUDA backend runs on the CPU, its threads in that order."""
    if find_compiler() is None:
        pytest.skip("the CUDA kernels' emulation needs a C++20 compiler: install g++, or set CXX")
    builds = request.config.cache.mkdir("cuda_emulator")
    with ExitStack() as stack:
        yield lambda order: stack.enter_context(emulated(builds, order))


def usable(request: pytest.FixtureRequest) -> Backend:
    """The backend that a fixture's parameter names, or a skip that says why it does not work here."""
    if request.param == "emulated":
        return request.getfixturevalue("emulate")("shuffled")
    backend = Backend.named(request.param)
    reason = backend.why_unavailable()
    if reason:
        pytest.skip(f"backend {request.param}: {reason}")
    return backend


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
