"""Which metrics there are: every protocol takes all of them, in this order, which is that of records and tables."""

from __future__ import annotations

from functools import cache

from envgs_bench.import_path import load_import_path

from .metric import Metric

REGISTERED = {  # lower-case letters, digits and _: names are keys of records and parts of files' names
    "psnr": "envgs_bench.metrics.psnr:METRIC",
    "ssim": "envgs_bench.metrics.ssim:METRIC",
    "flip": "envgs_bench.metrics.flip:METRIC",
    "lpips": "envgs_bench.metrics.lpips:METRIC",
    "dists": "envgs_bench.metrics.dists:METRIC",
}
CORRECTED = "cc_"  # what the name of a metric of color-corrected pictures begins with


def registered_metrics() -> dict[str, Metric]:
    """The metrics by name."""
    return {name: _metric(path) for name, path in REGISTERED.items()}


def corrected_metrics() -> dict[str, Metric]:
    """Those that are taken of color-corrected pictures too, by the name that they have there."""
    return {CORRECTED + name: metric for name, metric in registered_metrics().items() if metric.corrected}


@cache
def _metric(path: str) -> Metric:
    found = load_import_path(path)
    assert isinstance(found, Metric), path
    return found
