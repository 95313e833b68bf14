"""Cost: what a trained model takes of memory, and what it took to train it."""

from __future__ import annotations

from envgs_bench.methods.method import Method
from envgs_bench.records import Cost

from .memory import peak_device_bytes, peak_host_bytes
from .training import Training


def cost_of(method: Method, training: Training) -> Cost:
    """What the training cost so far."""
    sizes = method.model_bytes()
    return Cost(
        primitives=method.primitives(),
        bytes=sizes,
        model_bytes=sum(sizes.values()),
        train_seconds=training.seconds,
        peak_host_bytes=max(training.peak_host_bytes, peak_host_bytes()),
        peak_device_bytes=peak_device_bytes(method.device),
        skipped_steps=int(method.skipped_steps),
        peak_primitives=training.peak_primitives,
    )
