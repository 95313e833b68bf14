"""Too few training views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from envgs_bench.core import Scene

from ..errors import DatasetError


def thin_out(scene: Scene, count: float, rng: np.random.Generator) -> Scene:
    """`count` of the training views, evenly spaced in their order from a random first one; points stay as they are.

    Raises:
        DatasetError: there are not more to choose from.
    """
    wanted, present = int(count), len(scene.train)
    if wanted >= present:
        raise DatasetError(
            f"{scene.name} has {present} training views, expected more than {wanted} to keep {wanted} of"
        )
    first = rng.uniform()
    kept = ((np.arange(wanted) + first) * present / wanted).astype(int)
    return replace(scene, train=[scene.train[index] for index in kept])
