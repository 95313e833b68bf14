"""Trained runs as folders, without a process, a score or a picture: what commands open again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.run_folder import CHECKPOINT, CONFIG_NAME
from envgs_bench.settings import parse_settings
from envgs_bench.stages.perturbations import load_run_scene


def trained_run(folder: Path, kind: str, steps: int = 12, **settings: Any) -> Method:
    """Train method `kind` on the fakes' data set `tiny` and leave what `reopen` takes in `folder`."""
    run = parse_settings(
        {
            "method": {"name": kind, "kind": kind, "settings": settings},
            "dataset": {"name": "tiny", "kind": "fakes.datasets:tiny"},
            **{"protocol": "envgs", "seed": 0, "steps": steps, "device": "cpu", "timeout_minutes": None},
            **{"timing": {"frames": 1, "seconds": 0.01}, "force": False},
            **{"runs_dir": str(folder.parent), "cache_dir": str(folder.parent / "cache")},
        }
    )
    scene = load_run_scene(run)
    method = create_method(kind, run.method.settings, "cpu", run.seed)
    method.initialize(scene, steps)
    for step in range(1, steps + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
    method.prepare()
    method.save(folder / CHECKPOINT)
    (folder / CONFIG_NAME).write_text(yaml.safe_dump(run.model_dump(mode="json")))
    return method
