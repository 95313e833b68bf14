"""Training curves: how every method got where it ended, the mean over seeds and the band between the extremes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .runs import Run
from .sections import Section

MOST_POINTS = 80  # of a curve, evenly chosen
QUANTITIES = {
    "psnr": "training PSNR, dB",
    "primitives": "primitives",
    "primitives_base": "base primitives",
    "primitives_env": "environment primitives",
    "skipped_steps": "steps skipped so far",
    "loss": "loss",
}

Curve = dict[str, np.ndarray]  # column of curve.csv -> its values, one a row


def training_curves(section: Section) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """(data set, [{method, step, seconds, <quantity>: {mean, low, high}}]) of each with any, as plain values.

    Failed runs' curves count too, as far as they came: at each step the mean is over the runs that reached it.
    """
    for dataset in section.datasets:
        found: dict[str, list[Curve]] = {}
        for item in section.of(dataset):
            curve = read_curve(item.run)
            if curve is not None:
                found.setdefault(item.method, []).append(curve)
        if found:
            yield dataset, [{"method": method} | merged_curves(curves) for method, curves in found.items()]


def read_curve(run: Run) -> Curve | None:
    """step, seconds, loss, psnr, skipped_steps, primitives_<set> and their sum; None where there is no readable curve.

    Steps increase; a run that was cut off within a line is read up to that line.
    """
    try:
        head, *lines = (run.folder / "curve.csv").read_text(encoding="utf-8").splitlines()
        names = head.split(",")
        rows = [cells for line in lines if len(cells := line.split(",")) == len(names)]
        values = np.array([[float(cell or "nan") for cell in row] for row in rows], dtype=float).T
        curve = dict(zip(names, values, strict=True))
        steps, first = np.unique(curve["step"], return_index=True)
    except (OSError, ValueError, KeyError):
        return None
    first = first[np.isfinite(steps)]
    if not len(first):
        return None
    curve = {name: column[first] for name, column in curve.items()}
    sets = [column for name, column in curve.items() if name.startswith("primitives_")]
    return curve | ({"primitives": np.sum(sets, axis=0)} if sets else {})


def merged_curves(curves: list[Curve]) -> dict[str, Any]:
    """Mean, lowest and highest over the curves at each step that any of them has; None where there is no number."""
    steps = np.unique(np.concatenate([curve["step"] for curve in curves]))
    steps = steps[np.unique(np.linspace(0, len(steps) - 1, MOST_POINTS).round().astype(int))]
    merged: dict[str, Any] = {"step": steps.tolist(), "seconds": _band(curves, steps, "seconds")["mean"]}
    for name in QUANTITIES:
        if any(name in curve for curve in curves):
            merged[name] = _band(curves, steps, name)
    return merged


def _band(curves: list[Curve], steps: np.ndarray, name: str) -> dict[str, list[float | None]]:
    values = np.full((len(curves), len(steps)), np.nan)
    for row, curve in zip(values, curves, strict=True):
        if name in curve:
            _, mine, theirs = np.intersect1d(steps, curve["step"], assume_unique=True, return_indices=True)
            row[mine] = curve[name][theirs]
    finite = np.ma.masked_invalid(values)
    bands = {"mean": finite.mean(axis=0), "low": finite.min(axis=0), "high": finite.max(axis=0)}
    return {key: [_plain(value) for value in np.ma.filled(band, np.nan)] for key, band in bands.items()}


def _plain(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
