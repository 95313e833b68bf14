"""GPUs: which one the process of a run sees, where a machine has several. Runs spread evenly over them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from envgs_bench.file_lock import lock

from .cuda_probe import VISIBLE, surely_usable


@dataclass(frozen=True)
class Place:
    """Where a run's process runs.

    Attributes:
        environment: what its environment has besides the parent's.
        handles: open files that it keeps: the place is taken until all processes that have them are gone.
    """

    environment: dict[str, str] = field(default_factory=dict)
    handles: tuple[int, ...] = ()


@contextmanager
def placed(device: str) -> Iterator[Place]:
    """A place for a run on `device`: the GPU of "cuda:1", else the one with the fewest runs of this user.

    All sweeps of the machine count, those of other run folders too: a run holds a lock on a file of its own below the
    folder for temporary files. Nothing is refused: how many runs share a GPU is how many the launcher starts.
    """
    kind, _, number = device.partition(":")
    gpus = visible_gpus() if kind == "cuda" else []
    if len(gpus) < 2:
        yield Place()
        return
    gpu, handle = _taken([gpus[int(number)]] if number else gpus)
    try:
        yield Place({VISIBLE: gpu}, (handle,))
    finally:
        os.close(handle)


def visible_gpus() -> list[str]:
    """The GPUs that this process may use, as CUDA_VISIBLE_DEVICES names them."""
    if VISIBLE in os.environ:
        return [name.strip() for name in os.environ[VISIBLE].split(",") if name.strip()]
    count = surely_usable()
    if not count:
        import torch

        count = torch.cuda.device_count()
    return [str(number) for number in range(count)]


def _taken(gpus: list[str]) -> tuple[str, int]:
    """A GPU with as few runs as any, and the open, locked file that says that there is one more."""
    folder = Path(tempfile.gettempdir()) / f"envgs-bench-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    others = 0  # runs that each GPU has at least
    while True:
        for gpu in gpus:
            name = f"gpu-{gpu.replace(os.sep, '-')}-{others}.lock"
            handle = os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            try:
                lock(handle)
                return gpu, handle
            except BlockingIOError:
                os.close(handle)
        others += 1
