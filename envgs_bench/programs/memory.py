"""Memory of other processes: what a program and all that it starts hold, looked at now and then."""

from __future__ import annotations

from contextlib import suppress

import psutil


class ProgramOutOfMemory(MemoryError):
    """The program asked for more memory than it may have, or than there is."""


class MemoryWatch:
    """The most memory that a process and its children held whenever somebody looked.

    Args:
        pid: the process; None: its processes are not this machine's to see, as a container's.
        device: "cuda" to watch the GPU too: all that is taken there beyond what was when the watch began.
        host_gb: GiB that they may hold together, None: any.
        device_fraction: share of the GPU's memory that they may hold, None: any.

    Attributes:
        peak_host_bytes: private memory, that of all processes together; None where they cannot be seen.
        peak_device_bytes: None on a CPU.
    """

    def __init__(self, device: str, host_gb: float | None, device_fraction: float | None) -> None:
        self.peak_host_bytes: int | None = None
        self.peak_device_bytes: int | None = None
        self._host_gb, self._device_fraction = host_gb, device_fraction
        self._on_gpu = device == "cuda"
        self._taken_before = self._taken() if self._on_gpu else 0

    def look(self, pid: int | None) -> None:
        """Measure now. Raises ProgramOutOfMemory where a limit is passed."""
        if pid is not None:
            now = _private_bytes(pid)
            self.peak_host_bytes = max(self.peak_host_bytes or 0, now)
            if self._host_gb is not None and now > self._host_gb * 2**30:
                raise ProgramOutOfMemory(f"held {now / 2**30:.2f} GiB, memory_gb={self._host_gb:g}")
        if self._on_gpu:
            now = max(0, self._taken() - self._taken_before)
            self.peak_device_bytes = max(self.peak_device_bytes or 0, now)
            total = _device_memory()[1]
            if self._device_fraction is not None and now > self._device_fraction * total:
                raise ProgramOutOfMemory(
                    f"held {now / 2**30:.2f} GiB of the GPU, device_memory_fraction={self._device_fraction:g}"
                )

    @staticmethod
    def _taken() -> int:
        free, total = _device_memory()
        return total - free


def _device_memory() -> tuple[int, int]:
    """Bytes of the GPU that are free, and all that it has."""
    import torch  # which what only asks for a program's recipe does without

    return torch.cuda.mem_get_info()


def _private_bytes(pid: int) -> int:
    total = 0
    with suppress(psutil.Error):
        first = psutil.Process(pid)
        for process in (first, *first.children(recursive=True)):
            with suppress(psutil.Error):
                memory = process.memory_info()
                total += memory.rss - getattr(memory, "shared", 0)
    return total
