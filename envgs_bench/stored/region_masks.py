"""`envgs-bench masks`: masks of a region for every view of a capture, by a run on it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import Placement, Scene, View, build_bvh
from envgs_bench.datasets.export.masks import write_masks
from envgs_bench.diagnosis.reflection_score import REFLECTS, Surface, reflection_score, reflects
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
SURFACE = 0.5  # alpha from which a rendered pixel has a depth
BOX_MARGIN = 0.05  # added on each side, as a share of the edge: a room's walls stand on the box's faces


@dataclass(frozen=True)
class MaskChoice:
    """What is taken for reflecting."""

    region: str  # one of REGIONS
    by: str = "beta"  # of an EnvGS; or photographs, which look different from other sides, on any run's surfaces
    beta_min: float = 0.2  # by beta: primitives with a β above it reflect
    foreground: Sequence[float] | None = None  # x, y, z, radius of the ball that holds it, in the data's coordinates;
    # what the cameras stand around where None


class _Masks(Protocol):
    """One region's masks, and what made them."""

    about: dict[str, Any]

    def mask(self, view: View) -> Tensor:
        """[H, W] bool."""


def make_masks(run: Path, choice: MaskChoice, out: Path, device: str = "auto") -> Iterator[tuple[int, int]]:
    """Write <out>/masks_<region>/ with a mask a view, and <out>/masks_<region>.json on how they were made.

    Yields (masks made, of how many) after each; the files are written at the end, all or none.

    Raises:
        ValueError, FileNotFoundError: as `reopen` and `reopen_scene`; a method without β, or without surfaces; no
            primitive is taken; nothing reflects; there are masks that this command did not make.
    """
    folder, origin = out / f"masks_{choice.region}", out / f"masks_{choice.region}.json"
    if folder.exists() and not origin.is_file():
        raise ValueError(f"{folder}: is there already, and was not made by this command; move it away to replace it")
    settings, method = reopen(run, device)
    if not isinstance(method, GaussianMethod):
        raise ValueError(f"{run}: method {settings.method.name} has no sets of Gaussians that masks could be made by")
    scene = reopen_scene(run, settings)
    views = sorted([*scene.train, *scene.val, *scene.test], key=lambda view: view.name)
    made: _Masks = _OfPhotographs(method, scene) if choice.by == "photographs" else _OfBeta(run, method, scene, choice)
    masks: dict[str, NDArray[np.bool_]] = {}
    for number, view in enumerate(views, start=1):
        masks[view.name] = made.mask(view).cpu().numpy()
        yield number, len(views)
    share = float(sum(mask.mean() for mask in masks.values()) / len(masks))
    if share == 0:
        raise ValueError(f"{run}: nothing that reflects was found by {choice.by}; no masks were written")
    _write(settings, masks, folder)
    about = {
        **{"region": choice.region, "by": choice.by, "run": str(run.resolve()), "dataset": scene.name, "made": now()},
        **made.about,
        "mean_fraction": share,
    }
    write_atomically(origin, json.dumps(about, indent=1) + "\n")


def _write(settings: RunSettings, masks: dict[str, NDArray[np.bool_]], folder: Path) -> None:
    """All files or none: a capture with half a folder of masks would be refused."""
    partial = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(partial, ignore_errors=True)
    write_masks(settings.dataset, settings.cache_dir, masks, partial)
    shutil.rmtree(folder, ignore_errors=True)
    partial.replace(folder)


class _OfPhotographs:
    """What other training photographs show in another color, on the surfaces of any run."""

    def __init__(self, method: GaussianMethod, scene: Scene) -> None:
        self._method = method
        self._train = {view.name: self._surface(view) for view in scene.train}
        self.about: dict[str, Any] = {"threshold": REFLECTS}

    def mask(self, view: View) -> Tensor:
        own = self._train.get(view.name) or self._surface(view)
        others = [each for name, each in self._train.items() if name != view.name]
        return reflects(reflection_score(own, others), view.camera.height, view.camera.width)

    def _surface(self, view: View) -> Surface:
        height, width = Surface.size(view.camera)
        drawn = self._method.render(view.camera.resized(width, height).to(self._method.device))
        return Surface.of(view, torch.where(drawn.alpha > SURFACE, drawn.depth, 0.0))


class _OfBeta:
    """What an EnvGS draws of its foreground's primitives that reflect."""

    def __init__(self, run: Path, method: GaussianMethod, scene: Scene, choice: MaskChoice) -> None:
        if "beta_logits" not in method.model.sets[BASE].parameters.tensors:
            name = type(method).__name__
            raise ValueError(f"{run}: {name} knows no β; take a run of method=envgs, or --by photographs")
        self._device, self._region = method.device, choice.region
        self._radius, self._near = method.model.radius, method.model.near
        self._base = base = method.model.sets[BASE].parameters.gaussians().map(Tensor.detach)
        if choice.foreground:
            ball = _ball(choice.foreground, scene.placement)
        else:
            ball = foreground_ball([view.camera for view in scene.train])
        *center, radius = _in_data(ball, scene.placement)
        kept = reflecting(base, ball, choice.beta_min)
        if not kept.any():
            raise ValueError(
                f"{run}: none of {len(base):,} base primitives has β > {choice.beta_min:g} within {radius:.3g} of "
                f"({', '.join(f'{value:.10g}' for value in center)}); lower --beta, or give the foreground as "
                "--foreground X Y Z RADIUS"
            )
        self._foreground = base.map(lambda values: values[kept])
        low, high = quantile_box(scene.points.float(), BOX_QUANTILE)
        margin = BOX_MARGIN * (high - low)
        inside = in_box(base, low - margin, high + margin)
        self._surroundings = base.map(lambda values: values[inside])
        self._bvh = build_bvh(self._surroundings) if choice.region == "near_field" else None
        self.about: dict[str, Any] = {
            **{"beta_min": choice.beta_min, "base_primitives": len(base)},
            "foreground": {"center": center, "radius": radius, "primitives": int(kept.sum())},
        }

    def mask(self, view: View) -> Tensor:
        camera = view.camera.to(self._device)
        mirrors = reflective_mask(self._foreground, camera, self._near)
        if self._region == "reflective":
            return mirrors
        return mirrors & near_field_mask(self._base, self._surroundings, camera, self._radius, self._near, self._bvh)


def _ball(foreground: Sequence[float], placement: Placement) -> Ball:
    """The ball (x, y, z, radius) of the data, in the scene's world."""
    *center, radius = foreground
    return Ball(torch.from_numpy(placement.points_from_data(center)).float(), radius / placement.scale)


def _in_data(ball: Ball, placement: Placement) -> list[float]:
    """x, y, z, radius in the data's coordinates."""
    return [*placement.points_to_data(ball.center.numpy()).tolist(), ball.radius * placement.scale]
