"""The toy data source: from settings to a Scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from envgs_bench.core import Camera, Scene, View

from ..progress import streamed
from ..settings import SourceSettings, parse_dataset_settings
from ..split import split_views, validation_of
from ..store.cache import cached_scene
from ..store.scene_file import on_disk
from .cameras import cameras_around
from .lighting import bake
from .normal_noise import noisy_normals
from .points import sfm_points
from .render import geometry, picture
from .scenes import SCENES
from .world import World

VERSION = 8  # raise it with every change that alters a scene


class ToySettings(SourceSettings):
    """Settings of `kind: toy`."""

    kind: Literal["toy"]
    scene: Literal[
        "chrome_room",
        "sky_ball",
        "diffuse_room",
        "lacquered_table",
        "facing_mirrors",
        "glass",
        "wavy_mirror",
        "thin_rails",
    ]
    width: Annotated[int, Field(ge=8)] = 160  # pixels
    height: Annotated[int, Field(ge=8)] = 120
    views: Annotated[int, Field(ge=2)] = 48  # training and test views together
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.01  # standard deviation of the points' positions, m
    normal_noise: Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)] = 0.0  # mean angle of training views, °
    seed: Annotated[int, Field(ge=0)] = 0  # for textures, sky, light, pixels, points and normals
    supersampling: Annotated[int, Field(ge=1)] = 3  # rays along each side of a pixel


def load_toy(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A toy scene: pictures, exact normals and depth, the regions `reflective` and `near_field`, and a point cloud.

    Where there is glass, the region `transmissive` too. With `normal_noise` the training views' normals are an
    estimator's (`normal_noise.noisy_normals`); those of test and validation views, which scores refer
    to, are exact in any case.

    Raises:
        DatasetError: an unknown key, or a value out of range.
    """
    choice = parse_dataset_settings(ToySettings, settings)
    name = choice.name or f"toy/{choice.scene}"
    key = {"source": "toy", "version": VERSION, **choice.model_dump(), "name": name}
    return cached_scene(cache_dir, name, key, lambda: _make(choice, name))


def _make(choice: ToySettings, name: str) -> Scene:
    # one generator for each thing that is random, so that a change of one leaves the others as they are
    streams = np.random.SeedSequence(choice.seed).spawn(4 + choice.views)
    for_scene, for_light, for_points, *for_views, for_normals = (np.random.default_rng(stream) for stream in streams)
    description = SCENES[choice.scene](for_scene)
    world = World(description.parts, description.sky, description.bounces)
    bake(world, for_light)
    cameras = cameras_around(description.orbit, choice.views, choice.width, choice.height)

    def make_view(index: int) -> View:
        return _view(world, cameras[index], f"{index:04d}", choice.supersampling, for_views[index])

    views = on_disk(streamed("tracing views", make_view, range(choice.views)))
    train, test = split_views(views, name)
    val = validation_of(train)  # with exact normals, as test views
    points, colors = sfm_points(train, choice.noise, description.far_points, for_points)
    if choice.normal_noise:
        train = on_disk(_with_estimated_normals(view, choice.normal_noise, for_normals) for view in train)
    as_bytes = np.round(255 * colors) / 255  # a point's color has 8 bits wherever structure from motion stores it
    cloud = torch.from_numpy(points).float(), torch.from_numpy(as_bytes).float()
    return Scene(name, train, test, *cloud, val=val)


def _view(world: World, camera: Camera, name: str, supersampling: int, rng: np.random.Generator) -> View:
    exact = geometry(world, camera)
    regions = {"reflective": exact.reflective, "near_field": exact.near_field}
    if world.ior.any():
        regions["transmissive"] = exact.transmissive
    return View(
        name=name,
        camera=camera,
        image=torch.from_numpy(picture(world, camera, supersampling, rng)),
        masks={region: torch.from_numpy(mask) for region, mask in regions.items()},
        normal=torch.from_numpy(exact.normal).float(),
        depth=torch.from_numpy(exact.depth).float(),
    )


def _with_estimated_normals(view: View, mean_degrees: float, rng: np.random.Generator) -> View:
    assert view.normal is not None
    directions = view.camera.rays()[1].double().numpy()
    normals = noisy_normals(view.normal.double().numpy(), directions, mean_degrees, rng)
    return replace(view, normal=torch.from_numpy(normals).float())
