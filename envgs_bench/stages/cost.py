"""Cost: what a trained model takes of memory, and what it took to train it."""

from __future__ import annotations

import sys

import psutil
import torch

from envgs_bench.methods.method import Method
from envgs_bench.records import Cost

from .training import Training


def cost_of(method: Method, training: Training) -> Cost:
    """What the training cost so far."""
    sizes = method.model_bytes()
    return Cost(
        primitives=method.primitives(),
        bytes=sizes,
        model_bytes=sum(sizes.values()),
        train_seconds=training.seconds,
        peak_host_bytes=peak_host_bytes(),
        peak_device_bytes=peak_device_bytes(method.device),
        skipped_steps=int(method.skipped_steps),
        peak_primitives=training.peak_primitives,
    )


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
