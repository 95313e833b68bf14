"""Training views' normals as a bad estimator gives them, or none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from envgs_bench.core import Scene, View

from ..errors import DatasetError


def turn(scene: Scene, mean_degrees: float, rng: np.random.Generator) -> Scene:
    """Each training view's normals turned smoothly, a whole region at a time: see `noisy_normals`."""
    from ..toy.normal_noise import noisy_normals

    streams = rng.spawn(len(scene.train))

    def change(view: View, index: int) -> View:
        assert view.normal is not None
        directions = view.camera.rays()[1].double().numpy()
        turned = noisy_normals(view.normal.double().numpy(), directions, mean_degrees, streams[index])
        return replace(view, normal=torch.from_numpy(turned).to(view.normal))

    return _changed(scene, 1.0, change, rng)


def remove(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A random `share` of the training views without normals."""
    return _changed(scene, share, lambda view, index: replace(view, normal=None), rng)


def mirror(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A random `share` of the training views with normals mirrored from left to right in the camera's axes.

    What a wrong convention of axes does to an estimator's normals.
    """

    def change(view: View, index: int) -> View:
        assert view.normal is not None
        right = view.camera.world_to_camera[0, :3].to(view.normal)
        return replace(view, normal=view.normal - 2 * (view.normal @ right)[..., None] * right)

    return _changed(scene, share, change, rng)


def _changed(scene: Scene, share: float, change: Callable[[View, int], View], rng: np.random.Generator) -> Scene:
    """The scene with a random `share` of its training views changed; `change` gets a view and its index.

    Raises:
        DatasetError: no training view has normals.
    """
    if all(view.normal is None for view in scene.train):
        raise DatasetError(f"{scene.name} has no normals for its training views, so that none can be perturbed")
    count = round(share * len(scene.train))
    chosen = set(rng.permutation(len(scene.train))[:count].tolist())
    views = [
        change(view, index) if index in chosen and view.normal is not None else view
        for index, view in enumerate(scene.train)
    ]
    return replace(scene, train=views)
