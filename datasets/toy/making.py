"""Making a toy scene: described, lit, traced, and split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import Camera, Scene, View

from ..path_tracer import Tracer
from ..progress import streamed
from ..split import split_views, taken_out, validation_of
from ..store.scene_file import on_disk
from ..unseen import unseen_cameras
from .cameras import cameras_around
from .covisibility import covisible
from .lighting import bake
from .normal_noise import noisy_normals
from .path_traced import PathTraced
from .points import sfm_points
from .render import geometry, picture
from .scenes import SCENES
from .settings import ToySettings
from .world import World

Painter = Callable[[Camera, int, np.random.Generator], NDArray[np.uint8]]  # of supersampling² rays a pixel

SLIVER = 1e-3  # of the pixels of all views: a region with fewer is none


def make_scene(choice: ToySettings, name: str) -> Scene:
    """The scene that these settings describe."""
    # one generator for each thing that is random, so that a change of one leaves the others as they are
    sequence = np.random.SeedSequence(choice.seed)
    streams = sequence.spawn(4 + choice.views)
    for_scene, for_light, for_points, *for_views, for_normals = (np.random.default_rng(stream) for stream in streams)
    description = SCENES[choice.scene](for_scene)
    world = World(description.parts, description.sky, description.bounces)
    paint = _painter(world, for_light, choice.tracer)
    cores = 1 if choice.tracer == "gpu" else None  # so many threads as the tracer is for
    cameras = cameras_around(description.orbit, choice.views, choice.width, choice.height)

    def make_view(index: int) -> View:
        image = paint(cameras[index], choice.supersampling, for_views[index])
        return _view(world, cameras[index], f"{index:04d}", image)

    views = without_slivers(on_disk(streamed("tracing views", make_view, range(choice.views), cores)))
    train, test = split_views(views, name)
    val = validation_of(train)  # with exact normals, as test views
    val = with_covisible(world, val, taken_out(train, val))
    test = with_covisible(world, test, train)
    unseen = _unseen(world, paint, choice, train, sequence)
    points, colors = sfm_points(train, choice.noise, description.far_points, for_points)
    if choice.normal_noise:
        train = on_disk(_with_estimated_normals(view, choice.normal_noise, for_normals) for view in train)
    as_bytes = np.round(255 * colors) / 255  # a point's color has 8 bits wherever structure from motion stores it
    cloud = torch.from_numpy(points).float(), torch.from_numpy(as_bytes).float()
    return Scene(name, train, test, *cloud, val=val, unseen=unseen)


def _unseen(
    world: World, paint: Painter, choice: ToySettings, train: list[View], sequence: np.random.SeedSequence
) -> dict[str, list[View]]:
    """What is to be seen from between the training cameras, and from beyond them."""
    found = {}
    for place, seen in unseen_cameras([view.camera for view in train], choice.unseen, world).items():
        pixels = [np.random.default_rng(stream) for stream in sequence.spawn(len(seen))]
        views = [
            _view(world, camera, f"{place}-{index:04d}", paint(camera, choice.supersampling, rng))
            for index, (camera, rng) in enumerate(zip(seen, pixels, strict=True))
        ]
        found[place] = with_covisible(world, without_slivers(on_disk(views)), train)
    return found


def without_slivers(views: list[View]) -> list[View]:
    """The views with regions left empty that hardly any pixel belongs to: a score of a pixel or two says nothing."""
    pixels = sum(view.camera.width * view.camera.height for view in views)
    counts = {name: sum(int(view.masks[name].sum()) for view in views) for name in views[0].masks}
    slivers = [name for name, count in counts.items() if 0 < count < SLIVER * pixels]

    def emptied(masks: dict[str, Tensor]) -> dict[str, Tensor]:
        return masks | {name: torch.zeros_like(masks[name]) for name in slivers}

    return [replace(view, masks=emptied(view.masks)) for view in views]


def with_covisible(world: World, views: list[View], train: list[View]) -> list[View]:
    """The views with the region of what some training view shows too."""
    cameras = [view.camera for view in train]

    def compared(view: View) -> View:
        assert view.depth is not None
        seen = covisible(world, view.camera, view.depth.numpy(), cameras)
        return replace(view, masks=view.masks | {"covisible": torch.from_numpy(seen)})

    return on_disk(streamed("comparing views", compared, views))


def _painter(world: World, for_light: np.random.Generator, tracer: Tracer) -> Painter:
    """What makes a camera's picture: Mitsuba where something is of metal or under a coat, otherwise our own tracer."""
    if world.fresnel:
        return PathTraced(world.parts, world.sky, tracer).picture
    bake(world, for_light)
    return partial(picture, world)


def _view(world: World, camera: Camera, name: str, image: NDArray[np.uint8]) -> View:
    exact = geometry(world, camera)
    return View(
        name=name,
        camera=camera,
        image=torch.from_numpy(image),
        masks={region: torch.from_numpy(mask) for region, mask in exact.regions.items()},
        normal=torch.from_numpy(exact.normal).float(),
        depth=torch.from_numpy(exact.depth).float(),
    )


def _with_estimated_normals(view: View, mean_degrees: float, rng: np.random.Generator) -> View:
    assert view.normal is not None
    directions = view.camera.rays()[1].double().numpy()
    normals = noisy_normals(view.normal.double().numpy(), directions, mean_degrees, rng)
    return replace(view, normal=torch.from_numpy(normals).float())
