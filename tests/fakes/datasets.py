"""A data set that is there at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from envgs_bench.core import Scene
from envgs_bench.testing import tiny_scene


def tiny(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """The tiny scene, two views of it for testing, one region on the left half of the first."""
    scene = tiny_scene()
    left = torch.zeros(scene.test[0].image.shape[:2], dtype=torch.bool)
    left[:, : left.shape[1] // 2] = True
    masked = replace(scene.test[0], masks={"reflective": left})
    return replace(scene, name=settings["name"], train=scene.train[1:], test=[masked, scene.train[0]])
