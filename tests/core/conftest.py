"""What the core's tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from torch_threads import torch_threads


@pytest.fixture(autouse=True, scope="module")
def _two_threads() -> Iterator[None]:
    """The CPU backend shares its work between threads, even where `make test` gives each process one."""
    with torch_threads(2):
        yield
