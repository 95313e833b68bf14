"""Making a sampled scene: drawn, walked around, traced, and compared with its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from envgs_bench.core import Camera, Scene, View

from ..progress import streamed
from ..split import TEST_EVERY, split_views, taken_out, validation_of
from ..store.scene_file import on_disk
from ..toy.making import with_covisible, without_slivers
from ..unseen import unseen_cameras
from .attributes import attributes_of
from .distribution import PLACES as SHARES
from .distribution import one_of
from .estimated_normals import Estimator
from .pictures import Pictures, traced_pictures
from .place import Place
from .places import PLACES
from .points import sfm_cloud
from .settings import SampledSettings
from .truth import Truth, TruthOf
from .walks import cameras_of, drawn_walk

STREAMS = ("place", "walk", "pixels", "points", "normals")  # of random numbers: a change of one leaves the others


@dataclass(frozen=True)
class Drawn:
    """A scene before it is traced."""

    place: Place
    walk: str  # the kind
    cameras: list[Camera]
    truth: TruthOf
    unseen: dict[str, list[Camera]]

    @property
    def unseen_views(self) -> dict[str, Camera]:
        """Those where nobody stood, by the views' names."""
        return {
            f"{place}-{index:04d}": camera for place in self.unseen for index, camera in enumerate(self.unseen[place])
        }


def drawn(choice: SampledSettings) -> Drawn:
    """The place of that seed, and the cameras that see it."""
    for_place, for_walk = (_stream(choice, name) for name in ("place", "walk"))
    place = PLACES[one_of(for_place, SHARES)](for_place)
    truth = TruthOf(place.surfaces)
    kind, walk = drawn_walk(place, choice.views, for_walk)
    cameras = cameras_of(walk, place, truth.world, choice.width, choice.height, for_walk)
    train = [camera for index, camera in enumerate(cameras) if index % TEST_EVERY]
    return Drawn(place, kind, cameras, truth, unseen_cameras(train, choice.unseen, truth.world))


def traced(choice: SampledSettings, scene: Drawn) -> Pictures:
    others, rng = list(scene.unseen_views.values()), _stream(choice, "pixels")
    return traced_pictures(scene.place, scene.cameras, others, choice.supersampling, rng, choice.tracer)


def make_scene(choice: SampledSettings, name: str, pictures: Callable[[Drawn], Pictures]) -> Scene:
    """The scene of that seed, with the pictures that the last argument gives."""
    scene = drawn(choice)
    truths = list(streamed("looking at surfaces", scene.truth, scene.cameras))
    painted, count = pictures(scene), len(scene.cameras)
    views = [
        _view(f"{index:04d}", camera, truth, picture)
        for index, (camera, truth, picture) in enumerate(zip(scene.cameras, truths, painted[:count], strict=True))
    ]
    truth_of = {view.name: truth for view, truth in zip(views, truths, strict=True)}
    views = without_slivers(on_disk(views))
    train, test = split_views(views, name)
    val = validation_of(train)
    world = scene.truth.world
    others = zip(scene.unseen_views.items(), painted[count:], strict=True)
    unseen = [_view(name, camera, scene.truth(camera), picture) for (name, camera), picture in others]
    unseen = with_covisible(world, without_slivers(unseen), train) if unseen else []
    val, test = with_covisible(world, val, taken_out(train, val)), with_covisible(world, test, train)
    known = [truth_of[view.name] for view in train]
    cloud = sfm_cloud(train, known, _stream(choice, "points"))
    for_normals = _stream(choice, "normals")
    estimator = Estimator.drawn(for_normals)
    estimates = [estimator.estimate(truth, view.camera, for_normals) for view, truth in zip(train, known, strict=True)]
    train = on_disk(replace(v, normal=torch.from_numpy(n).float()) for v, n in zip(train, estimates, strict=True))
    by_place = {place: [view for view in unseen if view.name.startswith(f"{place}-")] for place in scene.unseen}
    found = attributes_of(train, known, [truth.normal for truth in known], cloud)
    points, colors = torch.from_numpy(cloud.points).float(), torch.from_numpy(cloud.colors).float()
    return Scene(name, train, test, points, colors, val=val, unseen=by_place, attributes=found)


def _stream(choice: SampledSettings, name: str) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(choice.seed, spawn_key=(STREAMS.index(name),)))


def _view(name: str, camera: Camera, truth: Truth, picture: np.ndarray) -> View:
    return View(
        name=name,
        camera=camera,
        image=torch.from_numpy(picture.copy()),
        masks={region: torch.from_numpy(mask) for region, mask in truth.regions.items()},
        normal=torch.from_numpy(truth.normal).float(),
        depth=torch.from_numpy(truth.depth).float(),
    )
