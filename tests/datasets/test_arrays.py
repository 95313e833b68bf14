"""Arrays: many at once."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from envgs_bench.datasets.formats.arrays import open_array


@pytest.fixture
def threads_change_in_collections() -> Iterator[None]:
    """Other threads run in the middle of collections of garbage, and there are many of these.

    So a thread is interrupted in code that otherwise nothing interrupts, as a callback of somebody's would by chance.
    """

    def give_way(*_: object) -> None:
        time.sleep(0)

    thresholds = gc.get_threshold()
    gc.callbacks.append(give_way)
    gc.set_threshold(20)
    yield
    gc.set_threshold(*thresholds)
    gc.callbacks.remove(give_way)


@pytest.mark.usefixtures("threads_change_in_collections")
def test_arrays_open_in_many_threads_at_once(tmp_path: Path) -> None:
    array = np.arange(36, dtype=np.float32).reshape(3, 4, 3)
    np.save(tmp_path / "array.npy", array)

    def is_read(path: Path) -> bool:
        return np.array_equal(open_array(path), array)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(is_read, [tmp_path / "array.npy"] * 3000))
