"""Training curves: how every method got where it ended, the mean over seeds and the band between the extremes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from envgs_bench.parts import BASE, ENV
from envgs_bench.records import LARGEST
from envgs_bench.regular_file import read_regular_text
from envgs_bench.run_folder import CURVE_NAME

from ..numbers.runs import Run
from ..tables.sections import Section

MOST_BYTES = 100_000_000  # of a curve.csv; a row a step of a million steps takes half
MAX_POINTS = 80  # points drawn of a curve, evenly chosen
QUANTITIES = {
    "psnr": "training PSNR, dB",
    "primitives": "primitives",
    f"primitives_{BASE}": "base primitives",
    f"primitives_{ENV}": "environment primitives",
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
        head, *lines = read_regular_text(run.folder / CURVE_NAME, MOST_BYTES).splitlines()
        names = head.split(",")
        rows = [line for line in lines if line.count(",") == len(names) - 1]
        values = np.loadtxt(rows, delimiter=",", ndmin=2) if rows else np.empty((0, len(names)))
        curve = dict(zip(names, values.T, strict=True))
        steps, first = np.unique(curve["step"], return_index=True)
    except (OSError, ValueError, KeyError):
        return None
    first = first[np.abs(steps) <= LARGEST]
    if not len(first):
        return None
    curve = {name: column[first] for name, column in curve.items()}
    sets = [column for name, column in curve.items() if name.startswith("primitives_")]
    return curve | ({"primitives": np.sum(sets, axis=0)} if sets else {})


def merged_curves(curves: list[Curve]) -> dict[str, Any]:
    """Mean, lowest and highest over the curves at each step that any of them has; None where there is no number."""
    steps = np.unique(np.concatenate([curve["step"] for curve in curves]))
    steps = steps[np.unique(np.linspace(0, len(steps) - 1, MAX_POINTS).round().astype(int))]
    merged: dict[str, Any] = {"step": steps.tolist(), "seconds": _band(curves, steps, "seconds")["mean"]}
    for name in QUANTITIES:
        if any(name in curve for curve in curves):
            merged[name] = _band(curves, steps, name)
    return merged


def _band(curves: list[Curve], steps: np.ndarray, name: str) -> dict[str, list[float | None]]:
    values = np.full((len(curves), len(steps)), np.nan)
    for row, curve in zip(values, curves, strict=True):
        if name in curve:
            places = np.searchsorted(curve["step"], steps).clip(max=len(curve["step"]) - 1)
            there = curve["step"][places] == steps
            row[there] = curve[name][places[there]]
    finite = np.abs(values) <= LARGEST
    count = finite.sum(axis=0)
    mean = np.where(finite, values, 0).sum(axis=0) / np.maximum(count, 1)
    low, high = np.where(finite, values, np.inf).min(axis=0), np.where(finite, values, -np.inf).max(axis=0)
    return {key: _plain(band, count > 0) for key, band in (("mean", mean), ("low", low), ("high", high))}


def _plain(values: np.ndarray, known: np.ndarray) -> list[float | None]:
    """Five significant digits each, None where nothing is known."""
    found = np.where(known, values, 0)
    unit = 10.0 ** (4 - np.floor(np.log10(np.maximum(np.abs(found), 1e-30))))
    short = (np.round(found * unit) / unit).tolist()
    return [value if there else None for value, there in zip(short, known.tolist(), strict=True)]
