"""Cost: what a trained model takes of memory and of a disk, and what it took to train it."""

from __future__ import annotations

from pathlib import Path

from envgs_bench.memory import peak_device_bytes, peak_host_bytes
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.method import Method
from envgs_bench.methods.storage import compact
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
        peak_host_bytes=max(training.peak_host_bytes, peak_host_bytes()),
        peak_device_bytes=peak_device_bytes(method.device),
        skipped_steps=int(method.skipped_steps),
        peak_primitives=training.peak_primitives,
    )


def with_files(cost: Cost, method: Method, checkpoint: Path) -> Cost:
    """The cost with the bytes of what `Method.save` left in the folder `checkpoint`, and of the model made compact."""
    files = [path for path in checkpoint.rglob("*") if path.is_file()]
    sizes = {"checkpoint_bytes": sum(path.stat().st_size for path in files), "compact_bytes": _compact_bytes(method)}
    return cost.model_copy(update=sizes)


def _compact_bytes(method: Method) -> int | None:
    """None of a method that is not made of Gaussians, and of a model that the layout refuses."""
    if not isinstance(method, GaussianMethod):
        return None
    try:
        return len(compact.encode(type(method).__name__, method.state()))
    except ValueError:
        return None
