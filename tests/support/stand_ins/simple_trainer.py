"""In the place of gsplat's example trainer: what it leaves, of a training that took no time."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from opensplat import write_gaussians
from PIL import Image

parser = argparse.ArgumentParser()
parser.add_argument("--data-dir", type=Path)
parser.add_argument("--result-dir", type=Path)
parser.add_argument("--test-every", type=int)
options, _ = parser.parse_known_args()
for name in ("renders", "stats"):
    (options.result_dir / name).mkdir(parents=True)
photographs = sorted((options.data_dir / "images").iterdir())[:: options.test_every]
for number, path in enumerate(photographs):
    photograph = np.asarray(Image.open(path).convert("RGB"))
    beside = np.concatenate([photograph, np.full_like(photograph, 128)], axis=1)
    Image.fromarray(beside).save(options.result_dir / "renders" / f"val_step0000_{number:04d}.png")
(options.result_dir / "stats" / "train_step0000_rank0.json").write_text(json.dumps({"ellipse_time": 1.5}))
write_gaussians(options.result_dir / "ply" / "point_cloud_0.ply")
