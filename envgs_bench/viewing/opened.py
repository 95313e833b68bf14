"""OpenedRun: a trained run that is ready to be looked at, and what it looks like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.method import Method
from envgs_bench.methods.storage.gaussian_files import is_gaussian_file
from envgs_bench.programs.gaussians import open_gaussians
from envgs_bench.runs.job import resolve_device
from envgs_bench.stages.evaluation import scored_views
from envgs_bench.stages.pictures import as_bytes, depth_unit, layer_pictures
from envgs_bench.stored.reopening import reopen, reopen_scene

IMAGE = "image"  # the picture itself, among its layers
DRAWN = ("normal", "depth")  # the layers that every method's pictures have, after its own

Picture = NDArray[np.uint8]  # [H, W, 3], sRGB


@dataclass(frozen=True)
class OpenedRun:
    """A trained method, prepared to render, and the scene that it was trained on.

    Attributes:
        label: its method's name and its seed.
        views: those that the run was scored on.
        depth_unit: world units, see `stages.pictures.depth_picture`.
    """

    label: str
    method: Method
    scene: Scene
    views: Sequence[View]
    depth_unit: float

    def draw(self, camera: Camera) -> dict[str, Tensor]:
        """IMAGE and every layer as `camera` sees them, values in [0, 1]: [H, W], [H, W, 1] or [H, W, 3], on the CPU.

        They are what the run left of a test view where the camera is that view's. Once this returns, the device has
        done its work.
        """
        rendering = self.method.render(camera.to(self.method.device))
        layers = {IMAGE: rendering.color, **layer_pictures(rendering, self.depth_unit)}
        return {name: layer.cpu() for name, layer in layers.items()}

    @property
    def cameras(self) -> list[Camera]:
        """All cameras of the scene, those of `views` first."""
        scored = {view.name for view in self.views}
        others = [view.camera for view in (*self.scene.train, *self.scene.test) if view.name not in scored]
        return [view.camera for view in self.views] + others


def open_run(folder: Path, device: str = "auto") -> OpenedRun:
    """The trained run in `folder`.

    Raises:
        ValueError, FileNotFoundError: as `reopen` and `reopen_scene`.
    """
    settings, method = reopen(folder, device)
    scene = reopen_scene(folder, settings)
    method.prepare()
    views = scored_views(scene, settings.score_on)
    unit = depth_unit([view.camera for view in views])
    return OpenedRun(f"{settings.method.name}, seed {settings.seed}", method, scene, views, unit)


def open_runs(folders: Sequence[Path], device: str = "auto") -> list[OpenedRun]:
    """Trained runs of one scene, whose labels tell them apart, and files of Gaussians that other programs wrote of it.

    A file stands in the scene of the first run, whose data's coordinates it is in.

    Raises:
        ValueError, FileNotFoundError: as `open_run` and `open_gaussians`; or there are files alone, or the runs were
            not scored on the same views.
    """
    first = next((folder for folder in folders if not is_gaussian_file(folder)), None)
    if first is None:
        raise ValueError(f"{folders[0]}: a file of Gaussians says nothing of cameras; give a run of its scene too")
    scene_run = open_run(first, device)
    runs = [
        _opened_file(folder, scene_run, device)
        if is_gaussian_file(folder)
        else scene_run
        if folder == first
        else open_run(folder, device)
        for folder in folders
    ]
    for run, folder in zip(runs, folders, strict=True):
        if not _same_places(run.views, runs[0].views):
            raise ValueError(
                f"{folder}: is of scene {run.scene.name}, and {folders[0]} of {runs[0].scene.name} with other test "
                "cameras; give runs of one scene"
            )
    labels = [run.label for run in runs]
    return [
        replace(run, label=f"{run.label} ({number})") if labels.count(run.label) > 1 else run
        for number, run in enumerate(runs, start=1)
    ]


def _opened_file(path: Path, run: OpenedRun, device: str) -> OpenedRun:
    """The Gaussians of a file, in the run's scene."""
    method = open_gaussians(path, run.scene, None, resolve_device(device))
    method.prepare()
    return replace(run, label=path.name, method=method)


def _same_places(ours: Sequence[View], theirs: Sequence[View]) -> bool:
    """Whether the views have the same names, and cameras in the same places."""
    places = {view.name: view.camera.center for view in theirs}
    return {view.name for view in ours} == set(places) and all(
        torch.allclose(view.camera.center, places[view.name], atol=1e-4) for view in ours
    )


def as_picture(layer: Tensor) -> Picture:
    """One of `OpenedRun.draw`'s layers as 8-bit sRGB; gray becomes three equal channels."""
    values = as_bytes(layer)
    return values if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2)
