"""Arrays: NumPy's files, mapped, so that a header that promises more than its file holds costs nothing."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envgs_bench.regular_file import require_regular

from ..errors import DatasetError

# NumPy has Python's parser read a header, and Python 3.11's fails, now and then, where two threads parse at once.
_parsing = threading.Lock()


def open_array(path: Path) -> NDArray:
    """The array of a `.npy`, read-only, its values read as they are used.

    Raises:
        DatasetError: there is none, it is another file (an archive of arrays too), or not a whole one.
    """
    try:
        require_regular(path)
        with _parsing:
            return np.lib.format.open_memmap(path, mode="r")
    except Exception as error:  # NumPy parses the header as Python's source, and raises whatever that leads to
        raise DatasetError(f"{path}: cannot be read as an array ({error}); write it again with numpy.save") from error
