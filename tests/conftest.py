"""Fixtures that several test files share."""

from __future__ import annotations

import pytest
from core_scenes import Backend


def usable(name: str) -> Backend:
    """The backend called `name`, or a skip that says why it does not work here."""
    backend = Backend.named(name)
    reason = backend.why_unavailable()
    if reason:
        pytest.skip(f"backend {name}: {reason}")
    return backend


@pytest.fixture(params=["cpu", "cuda", "torch"])
def rasterizer(request: pytest.FixtureRequest) -> Backend:
    return usable(request.param)


@pytest.fixture(params=["cpu", "cuda", "torch", "embree"])
def tracer(request: pytest.FixtureRequest) -> Backend:
    return usable(request.param)


@pytest.fixture(params=["cpu", "cuda"])
def native(request: pytest.FixtureRequest) -> Backend:
    """The backends that are fast, in float32, and held against the oracle."""
    return usable(request.param)
