"""Probe: what a finished model is along fixed rays, the same for all seeds, so that two seeds' models can be compared.

One small file in the run's folder, safetensors; checkpoints, which are large, need not be kept for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from .regular_file import require_regular
from .run_folder import PROBE_NAME

MOST_BYTES = 1_000_000  # of a probe; one takes a few ten thousand
Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Probe:
    """What camera rays meet, and what fixed reflected rays see."""

    radius: float  # the scene's, world units
    depth: Floats  # [P] expected camera-frame depth, world units; 0 where nothing was drawn
    normal: Floats  # [P, 3] unit, world frame; 0 where nothing was drawn
    reflected: Floats | None  # [R, 3] sRGB; None of a method without reflections, or without known rays


def write_probe(run: Path, probe: Probe) -> None:
    """Leave the probe in the run's folder: depths of 4 bytes, all else of 2."""
    tensors: dict[str, NDArray[Any]] = {
        "radius": np.array([probe.radius], np.float32),
        "depth": probe.depth.astype(np.float32),
        "normal": probe.normal.astype(np.float16),
    }
    if probe.reflected is not None:
        tensors["reflected"] = probe.reflected.astype(np.float16)
    (run / PROBE_NAME).write_bytes(save(tensors))


def read_probe_if_any(run: Path) -> Probe | None:
    """The probe in the run's folder, float64; None where there is none that can be read."""
    path = run / PROBE_NAME
    try:
        require_regular(path, MOST_BYTES)
        found = {name: values.astype(np.float64) for name, values in load(path.read_bytes()).items()}
    except (OSError, SafetensorError, ValueError, KeyError, TypeError):
        return None
    radius, depth, normal = (found.get(name, np.zeros(0)) for name in ("radius", "depth", "normal"))
    reflected = found.get("reflected")
    sound = radius.shape == (1,) and depth.ndim == 1 and normal.shape == (len(depth), 3)
    sound = sound and (reflected is None or reflected.shape[1:] == (3,))
    if not sound or not all(np.isfinite(values).all() for values in found.values()):
        return None
    return Probe(float(radius[0]), depth, normal, reflected)
