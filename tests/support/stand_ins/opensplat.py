"""In the place of OpenSplat: `opensplat DATA -o FILE -n STEPS …` leaves a file of Gaussians, and learns nothing."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

NAMES = (*"xyz", *(f"f_dc_{channel}" for channel in range(3)), "opacity", *(f"scale_{axis}" for axis in range(3)))


def write_gaussians(path: Path) -> None:
    """A cloud of gray ones around the world's origin."""
    random = np.random.default_rng(0)
    table = np.zeros(50, dtype=[(name, "<f4") for name in (*NAMES, *(f"rot_{index}" for index in range(4)))])
    for name in "xyz":
        table[name] = random.normal(size=50)
    table["rot_0"] = 1
    for axis in range(3):
        table[f"scale_{axis}"] = -1
    path.parent.mkdir(parents=True, exist_ok=True)
    PlyData([PlyElement.describe(table, "vertex")]).write(path)


if __name__ == "__main__":
    steps = int(sys.argv[sys.argv.index("-n") + 1])
    print(f"Step {steps}: 0.5 (100%)", flush=True)
    write_gaussians(Path(sys.argv[sys.argv.index("-o") + 1]))
