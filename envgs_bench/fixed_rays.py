"""Fixed-ray samples: what a finished model is along rays that are the same for all seeds, so that two can be compared.

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
from .run_folder import SAMPLES_NAME

MOST_BYTES = 1_000_000  # of a file; one takes a few ten thousand
Floats = NDArray[np.floating]


@dataclass(frozen=True)
class FixedRaySamples:
    """What camera rays meet, and what fixed reflected rays see."""

    radius: float  # the scene's, world units
    depth: Floats  # [P] expected camera-frame depth, world units; 0 where nothing was drawn
    normal: Floats  # [P, 3] unit, world frame; 0 where nothing was drawn
    reflected: Floats | None  # [R, 3] sRGB; None of a method without reflections, or without known rays


def write_samples(run: Path, samples: FixedRaySamples) -> None:
    """Leave the samples in the run's folder: depths of 4 bytes, all else of 2."""
    tensors: dict[str, NDArray[Any]] = {
        "radius": np.array([samples.radius], np.float32),
        "depth": samples.depth.astype(np.float32),
        "normal": samples.normal.astype(np.float16),
    }
    if samples.reflected is not None:
        tensors["reflected"] = samples.reflected.astype(np.float16)
    (run / SAMPLES_NAME).write_bytes(save(tensors))


def read_samples_if_any(run: Path) -> FixedRaySamples | None:
    """The samples in the run's folder, float64; None where there is none that can be read."""
    path = run / SAMPLES_NAME
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
    return FixedRaySamples(float(radius[0]), depth, normal, reflected)
