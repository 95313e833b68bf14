"""Another program: for each test camera of a folder in blender's layout, the photograph whose camera is nearest.

    python nearest_view.py FOLDER RENDERS

It knows nothing of envgs-bench: it reads transforms_train.json and transforms_test.json, and writes RENDERS/<view>.png.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np


def read_cameras(folder: Path, split: str) -> dict[str, np.ndarray]:
    """Camera-to-world poses [4, 4] of a split, by the path of the picture without its suffix."""
    frames = json.loads((folder / f"transforms_{split}.json").read_text(encoding="utf-8"))["frames"]
    return {frame["file_path"]: np.array(frame["transform_matrix"]) for frame in frames}


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """How differently two cameras stand and look."""
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]) + np.linalg.norm(one[:3, 2] - other[:3, 2]))


def main(folder: Path, renders: Path) -> None:
    renders.mkdir(parents=True)
    known = read_cameras(folder, "train")
    for path, pose in read_cameras(folder, "test").items():
        nearest = min(known, key=lambda name: distance(known[name], pose))
        shutil.copy(folder / f"{nearest}.png", renders / f"{Path(path).name}.png")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
