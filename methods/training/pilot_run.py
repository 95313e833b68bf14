"""Pilot runs: two methods trained for a moment, to ask a scene before a run what no look at its photographs tells.

Each is trained from the start, for as many steps whatever the run's length, on the run's training views made small.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Scene, View
from envgs_bench.core.vectors import unit

from ..method import Method

SCHEDULE = 600  # steps of the run whose beginning a pilot run is
STEPS = 200  # that it takes
PIXELS = 7_000  # of a view, at most
SHORTEST_RUN = 2_000  # steps of a run that can afford a pilot run


def smaller(view: View) -> View:
    """The view with at most PIXELS pixels, by area averaging: its image and its normals, without any masks."""
    shrink = math.sqrt(PIXELS / (view.camera.width * view.camera.height))
    if shrink >= 1:
        return replace(view, masks={})
    width, height = (max(1, int(shrink * size)) for size in (view.camera.width, view.camera.height))

    def averaged(pixels: Tensor) -> Tensor:
        return functional.interpolate(pixels.movedim(2, 0)[None], (height, width), mode="area")[0].movedim(0, 2)

    image = averaged(view.rgb() * 255).round().to(torch.uint8)
    normal = None if view.normal is None else unit(averaged(view.normal.float()))
    camera = view.camera.resized(width, height)
    return View(view.name, camera, image, normal=normal)


def train_briefly(method: Method, scene: Scene) -> None:
    """Train the new method on the scene for a pilot run's steps; it can draw then."""
    method.initialize(scene, SCHEDULE)
    order = torch.Generator().manual_seed(0)
    rows: list[int] = []
    for step in range(1, STEPS + 1):
        if not rows:
            rows = torch.randperm(len(scene.train), generator=order).tolist()
        method.training_step(scene.train[rows.pop()], step)
    method.settle()
    method.prepare()
