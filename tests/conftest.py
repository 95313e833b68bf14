"""Fixtures that several test files share."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from backends import EMULATED, usable
from core_scenes import Backend
from cuda_emulator.emulator import emulated, find_compiler
from hydra.core.config_store import ConfigStore

from envgs_bench.runs import started_run


def pytest_collection() -> None:
    gc.disable()


def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: the garbage collector need not look through it each time."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _one_starter() -> Iterator[None]:
    """A test's name, which pytest puts into the environment, is no reason to start another process that starts runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(started_run, "CHANGING", (*started_run.CHANGING, "PYTEST_CURRENT_TEST"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_store() -> Iterator[None]:
    """Hydra copies all that it was offered before each composition, a fifth of its time, and changes nothing of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConfigStore, "__deepcopy__", lambda store, _: store, raising=False)
        yield


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
