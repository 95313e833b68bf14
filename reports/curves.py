"""Training curves: how every method got where it ended, the mean over seeds and the band between the extremes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from .runs import Run
from .sections import Section

MOST_POINTS = 80  # of a curve, evenly chosen
QUANTITIES = {"psnr": "training PSNR, dB", "loss": "loss", "primitives": "primitives"}


def training_curves(section: Section) -> list[dict[str, Any]]:
    """Per data set with any: dataset, curves: [{method, step, seconds, <quantity>: {mean, low, high}}], plain values.

    Failed runs' curves count too, as far as they came: at each step the mean is over the runs that reached it.
    """
    found = []
    for dataset in section.datasets:
        frames: dict[str, list[pd.DataFrame]] = {}
        for item in section.of(dataset):
            frame = read_curve(item.run)
            if frame is not None:
                frames.setdefault(item.method, []).append(frame)
        if frames:
            curves = [{"method": method} | merged_curves(group) for method, group in frames.items()]
            found.append({"dataset": dataset, "curves": curves})
    return found


def read_curve(run: Run) -> pd.DataFrame | None:
    """step, seconds, loss, psnr, primitives (of all sets), or None where the run left no readable curve."""
    try:
        frame = pd.read_csv(run.folder / "curve.csv", dtype="float64")
    except (OSError, ValueError):
        return None
    if "step" not in frame or frame["step"].isna().all():
        return None
    frame = frame[frame["step"].notna() & ~frame["step"].duplicated()].set_index("step")
    sets = [name for name in frame if str(name).startswith("primitives_")]
    return frame.assign(primitives=frame[sets].sum(axis=1)) if sets else frame


def merged_curves(frames: list[pd.DataFrame]) -> dict[str, Any]:
    """Mean, lowest and highest over the frames at each step that any of them has; None where there is no number."""
    steps = np.unique(np.concatenate([frame.index.to_numpy(dtype=float) for frame in frames]))
    steps = steps[np.unique(np.linspace(0, len(steps) - 1, MOST_POINTS).round().astype(int))]
    merged: dict[str, Any] = {"step": steps.tolist(), "seconds": _band(frames, steps, "seconds")["mean"]}
    for name in QUANTITIES:
        if any(name in frame for frame in frames):
            merged[name] = _band(frames, steps, name)
    return merged


def _band(frames: list[pd.DataFrame], steps: np.ndarray, name: str) -> dict[str, list[float | None]]:
    columns = [frame[name].reindex(steps).to_numpy() for frame in frames if name in frame]
    if not columns:
        return {"mean": [None] * len(steps)}
    values = np.ma.masked_invalid(columns)
    bands = {"mean": values.mean(axis=0), "low": values.min(axis=0), "high": values.max(axis=0)}
    return {key: [_plain(value) for value in np.ma.filled(band, np.nan)] for key, band in bands.items()}


def _plain(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
