"""Pictures replayed from a graph: when one is recorded, and what is drawn where it had too little room."""

from dataclasses import replace

import pytest
import torch
from recordable import WaitsForTheDevice, pinhole, points_scene
from small_methods import SMALL

from envgs_bench.core import Camera, Rendering, Statistics
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training import frame_graphs
from envgs_bench.methods.training.frame_graphs import FrameGraphs, rendering_drawing

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
STEPS = 80  # on a GPU
FEWER = 24
DRAWN = [
    *((kind, {}) for kind in SMALL),
    ("envgs", {"beta_filter": 0.5, "rules": {"reflect_alpha": 0.5}}),
    ("envgs", {"supersampling": 2}),
]


class PlainGraph:
    """Draws what it recorded one kernel after the other, and has too little room as often as `spoils` says."""

    recorded = 0
    spoils = 0

    def __init__(self, drawing, camera):
        self.draw = drawing.draw
        PlainGraph.recorded += 1

    def replay(self, camera):
        if PlainGraph.spoils:
            PlainGraph.spoils -= 1
            return None
        return self.draw(camera)


@pytest.fixture
def plain_graphs(monkeypatch):
    monkeypatch.setattr(frame_graphs, "_Graph", PlainGraph)
    PlainGraph.recorded = PlainGraph.spoils = 0
    return PlainGraph


@pytest.fixture
def frames():
    return FrameGraphs(rendering_drawing(picture_of), torch.device("cpu"))


def picture_of(camera: Camera) -> Rendering:
    plane = torch.full((camera.height, camera.width), float(camera.world_to_camera[0, 3]))
    color = plane[..., None].expand(-1, -1, 3)
    return Rendering(color, plane, plane, color, color[..., :0], plane.int(), Statistics(torch.zeros(1)))


def moved(camera: Camera, by: float) -> Camera:
    pose = camera.world_to_camera.clone()
    pose[0, 3] += by
    return replace(camera, world_to_camera=pose)


def test_the_first_picture_of_a_size_is_drawn_without_a_graph_and_others_share_one(plain_graphs, frames):
    small, large = pinhole(), pinhole(8, 6)
    drawn = [float(frames.draw(moved(small, by)).color.mean()) for by in range(4)]
    assert drawn == [0, 1, 2, 3]
    assert plain_graphs.recorded == 1
    frames.draw(large)
    assert plain_graphs.recorded == 1
    assert frames.draw(large).alpha.shape == (6, 8)
    assert plain_graphs.recorded == 2


def test_another_graph_is_recorded_once_what_is_drawn_has_changed(plain_graphs, frames):
    for _ in range(3):
        frames.draw(pinhole())
    frames.forget()
    for _ in range(3):
        frames.draw(pinhole())
    assert plain_graphs.recorded == 2


def test_a_picture_that_lacked_room_is_drawn_without_its_graph_and_the_next_from_another(plain_graphs, frames):
    frames.draw(pinhole())
    plain_graphs.spoils = 1
    assert float(frames.draw(moved(pinhole(), 2)).color.mean()) == 2
    assert plain_graphs.recorded == 1
    assert float(frames.draw(moved(pinhole(), 3)).color.mean()) == 3
    assert plain_graphs.recorded == 2


def test_a_method_draws_what_its_last_step_left(plain_graphs, monkeypatch):
    scene, pictures = points_scene(), {False: [], True: []}
    for captures, colors in pictures.items():
        method = create_method("2dgs", {"backend": "cpu"})
        method.initialize(scene, 1000)
        for step in range(1, 4):
            method.runner.uses_graphs = False  # steps are another matter
            method.training_step(scene.train[0], step)
            method.pictures.uses_graphs = captures
            colors += [method.render(view.camera).color for view in scene.train]
    assert plain_graphs.recorded == 3
    for with_graphs, without in zip(pictures[True], pictures[False], strict=True):
        assert torch.equal(with_graphs, without)


@pytest.mark.parametrize(("kind", "settings"), DRAWN)
def test_no_picture_waits_for_the_device(kind, settings):
    method, scene = trained(kind, "cpu", **settings)
    method.prepare()
    with torch.no_grad(), WaitsForTheDevice() as waits:
        method.draw(scene.test[0].camera, None)
        method.pictures.color(scene.test[0].camera)
    assert waits.found == []


@needs_cuda
@pytest.mark.parametrize(("kind", "settings"), DRAWN)
def test_a_recorded_picture_is_the_picture_cuda(kind, settings):
    method, scene = trained(kind, "cuda", **settings)
    cameras = [view.camera for view in scene.train]
    method.prepare()
    with torch.no_grad():
        expected = [method.draw(camera.to("cuda"), None)[0] for camera in cameras]
    found = [method.render(camera) for camera in [*cameras, *cameras]]
    assert method.pictures._renderings._graph is not None
    for picture, plain in zip(found, expected * 2, strict=True):
        for name in ("color", "alpha", "depth", "normal", "extras", "hits"):
            assert torch.equal(getattr(picture, name), getattr(plain, name)), name
        assert picture.layers.keys() == plain.layers.keys()
        for name, layer in picture.layers.items():
            assert torch.equal(layer, plain.layers[name]), name
        torch.testing.assert_close(picture.statistics.weights, plain.statistics.weights)
    colors = [method.picture(camera) for camera in [*cameras, *cameras]]
    assert method.pictures._colors._graph is not None
    for color, plain in zip(colors, expected * 2, strict=True):
        torch.testing.assert_close(color, plain.color, atol=1e-5, rtol=0)


@needs_cuda
def test_a_picture_that_outgrows_its_graph_is_drawn_all_the_same_cuda(monkeypatch):
    from envgs_bench.core.cuda import raster_pass

    monkeypatch.setattr(raster_pass, "MIN_CAPACITY", 1)
    method, scene = trained("2dgs", "cuda")
    far = moved(scene.train[0].camera, 0)
    far.world_to_camera[2, 3] += 500  # all primitives within a tile
    cameras = [far, far, far, *(view.camera for view in scene.train)]
    found = [method.render(camera).color for camera in cameras]
    with torch.no_grad():
        for color, camera in zip(found, cameras, strict=True):
            assert bool(color.isfinite().all())
            assert torch.equal(color, method.draw(camera.to("cuda"), None)[0].color)
    raster_pass._latest_instances.clear()


def trained(kind, device, **settings):
    scene = points_scene(width=96, height=72) if device == "cuda" else points_scene()
    method = create_method(kind, {**SMALL[kind], **settings}, device=device)
    steps = STEPS if device == "cuda" else FEWER
    method.initialize(scene, steps)
    for step in range(1, steps + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
    method.settle()
    return method, scene
