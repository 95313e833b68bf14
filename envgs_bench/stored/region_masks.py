"""`envgs-bench masks`: masks of a region for every view of a capture, from an EnvGS that was trained on it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Placement, Scene, build_bvh
from envgs_bench.datasets.export.masks import write_masks
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.initialization import quantile_box
from envgs_bench.methods.gaussians.regions import (
    Ball,
    foreground_ball,
    in_box,
    near_field_mask,
    reflecting,
    reflective_mask,
)
from envgs_bench.parts import BASE
from envgs_bench.records import write_atomically
from envgs_bench.runs.draft import now
from envgs_bench.settings import RunSettings

from .reopening import reopen, reopen_scene

REGIONS = ("reflective", "near_field")
BOX_QUANTILE = 0.995  # the share of the points that it holds, as where EnvGS places its environment (paper, Sec. 4.3)
BOX_MARGIN = 0.05  # added on each side, as a share of the edge: a room's walls stand on the box's faces


@dataclass(frozen=True)
class MaskChoice:
    """What is taken for reflecting foreground."""

    region: str  # one of REGIONS
    beta_min: float  # primitives with a β above it reflect
    foreground: Sequence[float] | None = None  # x, y, z, radius of the ball that holds it, in the data's coordinates;
    # what the cameras stand around where None


def make_masks(run: Path, choice: MaskChoice, out: Path, device: str = "auto") -> Iterator[tuple[int, int]]:
    """Write <out>/masks_<region>/ with a mask a view, and <out>/masks_<region>.json on how they were made.

    Yields (masks made, of how many) after each; the files are written at the end, all or none.

    Raises:
        ValueError, FileNotFoundError: as `reopen` and `reopen_scene`; a method without β; no primitive is taken; there
            are masks that this command did not make.
    """
    folder, origin = out / f"masks_{choice.region}", out / f"masks_{choice.region}.json"
    if folder.exists() and not origin.is_file():
        raise ValueError(f"{folder}: is there already, and was not made by this command; move it away to replace it")
    settings, method = reopen(run, device)
    if not (isinstance(method, GaussianMethod) and "beta_logits" in method.model.sets[BASE].parameters.tensors):
        raise ValueError(f"{run}: method {settings.method.name} knows no β; take a run of method=envgs")
    scene = reopen_scene(run, settings)
    views = sorted([*scene.train, *scene.val, *scene.test], key=lambda view: view.name)
    base = method.model.sets[BASE].parameters.gaussians().map(Tensor.detach)
    if choice.foreground:
        ball = _ball(choice.foreground, scene.placement)
    else:
        ball = foreground_ball([view.camera for view in scene.train])
    *center, radius = _in_data(ball, scene.placement)
    kept = reflecting(base, ball, choice.beta_min)
    if not kept.any():
        raise ValueError(
            f"{run}: none of {len(base):,} base primitives has β > {choice.beta_min:g} within {radius:.3g} of "
            f"({', '.join(f'{value:.10g}' for value in center)}); lower --beta, or give the foreground as --foreground "
            "X Y Z RADIUS"
        )
    drawing = _Drawing(choice.region, base, kept, scene, method.model.radius, method.model.near)
    masks: dict[str, NDArray[np.bool_]] = {}
    for number, view in enumerate(views, start=1):
        masks[view.name] = drawing.mask(view.camera.to(method.device)).cpu().numpy()
        yield number, len(views)
    _write(settings, masks, folder)
    about = {
        **{"region": choice.region, "run": str(run.resolve()), "dataset": scene.name, "made": now()},
        **{"beta_min": choice.beta_min, "base_primitives": len(base)},
        "foreground": {"center": center, "radius": radius, "primitives": int(kept.sum())},
        "mean_fraction": float(sum(mask.mean() for mask in masks.values()) / len(masks)),
    }
    write_atomically(origin, json.dumps(about, indent=1) + "\n")


def _write(settings: RunSettings, masks: dict[str, NDArray[np.bool_]], folder: Path) -> None:
    """All files or none: a capture with half a folder of masks would be refused."""
    partial = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(partial, ignore_errors=True)
    write_masks(settings.dataset, settings.cache_dir, masks, partial)
    shutil.rmtree(folder, ignore_errors=True)
    partial.replace(folder)


class _Drawing:
    """One region's masks, view by view."""

    def __init__(self, region: str, base: GaussianSet, kept: Tensor, scene: Scene, radius: float, near: float) -> None:
        self.region, self.base, self.radius, self.near = region, base, radius, near
        self.foreground = base.map(lambda values: values[kept])
        low, high = quantile_box(scene.points.float(), BOX_QUANTILE)
        margin = BOX_MARGIN * (high - low)
        inside = in_box(base, low - margin, high + margin)
        self.surroundings = base.map(lambda values: values[inside])
        self.bvh = build_bvh(self.surroundings) if region == "near_field" else None

    def mask(self, camera: Camera) -> Tensor:
        reflects = reflective_mask(self.foreground, camera, self.near)
        if self.region == "reflective":
            return reflects
        return reflects & near_field_mask(self.base, self.surroundings, camera, self.radius, self.near, self.bvh)


def _ball(foreground: Sequence[float], placement: Placement) -> Ball:
    """The ball (x, y, z, radius) of the data, in the scene's world."""
    *center, radius = foreground
    return Ball(torch.from_numpy(placement.points_from_data(center)).float(), radius / placement.scale)


def _in_data(ball: Ball, placement: Placement) -> list[float]:
    """x, y, z, radius in the data's coordinates."""
    return [*placement.points_to_data(ball.center.numpy()).tolist(), ball.radius * placement.scale]
