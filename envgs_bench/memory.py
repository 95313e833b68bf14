"""Memory: what this process takes of it, on the host and on the device, what there is, and how much it may take."""

from __future__ import annotations

import sys
from pathlib import Path

import psutil
import torch


def peak_host_bytes() -> int:
    """The most resident memory that this process ever held."""
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def peak_device_bytes(device: torch.device | str) -> int | None:
    """The most memory that this process's tensors ever took on a GPU; None on a CPU."""
    device = torch.device(device)
    return torch.cuda.max_memory_allocated(device) if device.type == "cuda" else None


def machine_memory() -> int:
    """Bytes of memory that this process may take: the machine's, or its container's where that is less."""
    total = psutil.virtual_memory().total
    for path in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        try:
            return min(total, int(Path(path).read_text(encoding="ascii")))
        except (OSError, ValueError):
            continue  # no such file, or "max"
    return total


def process_memory() -> int:
    """Bytes that this process holds and that no file could give back."""
    memory = psutil.Process().memory_info()
    return memory.rss - getattr(memory, "shared", 0)


def limit_memory(host_gb: float | None, device_fraction: float | None, device: str) -> None:
    """Have allocations refused beyond a limit: those of the host with MemoryError, a GPU's with OutOfMemoryError.

    Args:
        host_gb: GiB of private memory that this process may take beyond what it has now (Linux's RLIMIT_DATA, which
            counts neither files that are mapped to be read nor a GPU's addresses); None: no limit. Other systems have
            no such limit.
        device_fraction: share of the GPU's memory for its tensors, in (0, 1]; None: no limit.
        device: "cpu" or "cuda".
    """
    if device_fraction is not None and device.startswith("cuda"):
        torch.cuda.set_per_process_memory_fraction(device_fraction)
    if host_gb is not None and sys.platform == "linux":
        _set_data_limit(_data_bytes() + int(host_gb * 2**30))


def lift_limit() -> None:
    """Allow again what the system allows: there is a record to write."""
    if sys.platform == "linux":
        _set_data_limit(None)


def _set_data_limit(size: int | None) -> None:
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (most if size is None else size, most))


def _data_bytes() -> int:
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmData:"))
