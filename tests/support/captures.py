"""Small COLMAP captures written by hand, in the documented text format: neither our code nor pycolmap makes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 64, 48
PINHOLE = "PINHOLE 64 48 60.0 62.0 30.5 25.0"
OPENCV = "OPENCV 64 48 60.0 62.0 30.5 25.0 0.06 -0.03 0.002 -0.001"
UNTURNED = (1.0, 0.0, 0.0, 0.0)
DISTANCE = 1000.0
NAMES_OF_TEN = [f"{index:03d}.png" for index in range(10)]
POINTS = np.random.default_rng(7).uniform([-1, -0.7, 3], [1, 0.7, 5], (30, 3))


def gradient(width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """[H, W, 3] bytes: red grows with x, green with y, as a fraction of the size."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.round(255 * np.stack([x, y, 0.5 + 0 * x], axis=-1)).astype(np.uint8)


def center_of(index: int) -> np.ndarray:
    """Cameras stand in a row along x, unturned but for a small roll."""
    return np.array([0.1 * index, 0.02 * index, 0.0])


def quaternion_of(index: int) -> tuple[float, float, float, float]:
    """wxyz, world to camera: a roll of 0.02·index radians."""
    return float(np.cos(0.01 * index)), 0.0, 0.0, float(np.sin(0.01 * index))


def rotation_of(index: int) -> np.ndarray:
    angle = 0.02 * index
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def write_capture(
    root: Path,
    names: list[str],
    camera: str = PINHOLE,
    points: np.ndarray = POINTS,
    model: str = "sparse/0",
    seen_at: np.ndarray | None = None,
) -> Path:
    """A capture of the gradient picture under each name, with a text model below `root`; returns `root`.

    Every image sees every point at the same place of the picture, `seen_at` [P, 2], or none of them. Points that are
    seen lie so far away, before cameras without a roll, that PINHOLE sees them there from each of their places.
    """
    if seen_at is not None:
        points = DISTANCE * np.concatenate([(seen_at - [30.5, 25]) / [60, 62], np.ones((len(seen_at), 1))], axis=1)
    folder = root / model
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"# cameras\n1 {camera}\n")
    lines = ["# images"]
    for index, name in enumerate(names):
        turn, rotation = (quaternion_of(index), rotation_of(index)) if seen_at is None else (UNTURNED, np.eye(3))
        pose = [*turn, *(-rotation @ center_of(index))]
        places = [] if seen_at is None else [f"{x!r} {y!r} {i + 1}" for i, (x, y) in enumerate(seen_at.tolist())]
        lines += [f"{index + 1} {' '.join(map(repr, map(float, pose)))} 1 {name}", " ".join(places)]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{i + 1} {x!r} {y!r} {z!r} {10 * i % 256} 20 30 0.5" for i, (x, y, z) in enumerate(points.tolist())]
    if seen_at is not None:
        rows = [f"{row} {' '.join(f'{k + 1} {i}' for k in range(len(names)))}" for i, row in enumerate(rows)]
    (folder / "points3D.txt").write_text("\n".join(["# points", *rows]) + "\n")
    for name in names:
        path = root / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(gradient()).save(path, **({"quality": 100} if path.suffix.lower() == ".jpg" else {}))
    return root
