"""Which backends a test runs on, and why not on the others."""

from __future__ import annotations

import pytest
from core_scenes import Backend

EMULATED = pytest.param("emulated", marks=pytest.mark.slow)  # the CUDA backend's kernels, without a GPU


def usable(request: pytest.FixtureRequest) -> Backend:
    """The backend that a fixture's parameter names, or a skip that says why it does not work here."""
    if request.param == "emulated":
        return request.getfixturevalue("emulate")("shuffled")
    backend = Backend.named(request.param)
    reason = backend.why_unavailable()
    if reason:
        pytest.skip(f"backend {request.param}: {reason}")
    return backend
