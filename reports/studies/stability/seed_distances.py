"""Seed distances: how far the models of two seeds are from each other, along the same fixed rays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from envgs_bench.fixed_rays import FixedRaySamples, read_samples_if_any

from ...numbers.runs import Run


def _depth(a: FixedRaySamples, b: FixedRaySamples) -> float | None:
    """The median difference of the depths where both drew something, as a share of the scene radius."""
    if a.depth.shape != b.depth.shape or a.radius + b.radius <= 0:
        return None
    both = (a.depth > 0) & (b.depth > 0)
    return float(np.median(np.abs(a.depth - b.depth)[both])) / (0.5 * (a.radius + b.radius)) if both.any() else None


def _normals(a: FixedRaySamples, b: FixedRaySamples) -> float | None:
    """The mean angle between the normals where both drew something, degrees."""
    if a.normal.shape != b.normal.shape:
        return None
    lengths = [np.linalg.norm(samples.normal, axis=1) for samples in (a, b)]
    both = (lengths[0] > 0.5) & (lengths[1] > 0.5)
    if not both.any():
        return None
    cosine = (a.normal * b.normal).sum(axis=1)[both] / (lengths[0] * lengths[1])[both]
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def _reflected(a: FixedRaySamples, b: FixedRaySamples) -> float | None:
    """The root mean square difference of what reflected rays see, clamped to [0, 1], sRGB."""
    if a.reflected is None or b.reflected is None or a.reflected.shape != b.reflected.shape:
        return None
    return float(np.sqrt(np.square(np.clip(a.reflected, 0, 1) - np.clip(b.reflected, 0, 1)).mean()))


SEED_DISTANCES: Mapping[str, Callable[[FixedRaySamples, FixedRaySamples], float | None]] = {
    "seeds_depth": _depth,
    "seeds_normal_degrees": _normals,
    "seeds_reflected_rmse": _reflected,
}


def seed_distances(runs: Sequence[Run]) -> dict[str, tuple[float, ...]]:
    """Each run's median distance to the runs of the other seeds, by quantity; without those that have no other."""
    every = [samples for run in runs if run.ok and (samples := read_samples_if_any(run.folder)) is not None]
    found = {}
    for name, distance in SEED_DISTANCES.items():
        table = [[distance(a, b) if a is not b else None for b in every] for a in every]
        known = [[value for value in row if value is not None] for row in table]
        found[name] = tuple(float(np.median(row)) for row in known if row)
    return found
