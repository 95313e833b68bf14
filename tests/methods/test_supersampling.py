"""Several reflected rays a pixel, against closed forms, scikit-image, and what a far finer picture averages to."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from reflection_scenes import HEIGHT, WIDTH, make_camera, mirror
from schedules import begin
from skimage.measure import block_reduce
from small_methods import SMALL
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, Statistics, View
from envgs_bench.core.vectors import unit
from envgs_bench.methods.envmap import EnvMap, EnvMapSettings
from envgs_bench.methods.lighting.supersampling import averaged, finer, repeated
from envgs_bench.methods.registry import create_method

CENTER, RADIUS = torch.tensor([0.0, 0.0, 4.0]), 1.5
LIGHT = torch.tensor([0.3, 0.5, -0.8])


def ball(camera: Camera) -> Rendering:
    """A mirror ball before the camera, exactly as it is at the centers of pixels."""
    origins, directions = camera.rays()
    to_center, along = CENTER - origins, unit(directions)
    nearest = (to_center * along).sum(-1)
    inside = RADIUS**2 - (to_center.square().sum(-1) - nearest.square())
    hit = inside > 0
    distance = nearest - inside.clamp_min(0).sqrt()
    normal = unit(origins + distance[..., None] * along - CENTER) * hit[..., None]
    depth = torch.where(hit, distance / directions.norm(dim=-1), 0.0)
    full = hit.float()
    color = torch.zeros(*full.shape, 3)
    return Rendering(color, full, depth, normal, full[..., None], full.int(), Statistics(torch.zeros(0)))


def stripes(
    origins: Tensor, directions: Tensor, step: int | None, beta: Tensor
) -> tuple[Tensor, dict[str, Statistics]]:
    """Surroundings that vary by some degrees, smooth enough to be averaged."""
    wave = torch.sin(30 * directions @ unit(LIGHT))
    return (0.5 + 0.5 * wave)[..., None].expand(*wave.shape, 3), {}


def picture(factor: int, size: int, monkeypatch: pytest.MonkeyPatch) -> Tensor:
    """What is drawn of the ball with `factor`² rays a pixel, [size, size, 3]."""
    camera = Camera(torch.eye(4), torch.tensor([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1.0]]), size, size)
    method = EnvMap(EnvMapSettings(envmap_size=4, supersampling=factor))
    method.reflection.begun = True
    monkeypatch.setattr(method.model, "rasterize", lambda camera, step: ball(camera))
    monkeypatch.setattr(method.reflection.light, "color", stripes)
    return method.draw(camera, None)[0].color.detach()


def test_a_plane_is_as_far_away_between_pixels_as_it_is():
    """Depth at four and at nine points a pixel is that of their rays, inside the outermost pixel centers."""
    camera = make_camera()
    normal = unit(torch.tensor([0.4, -0.3, -1.0]))
    shown = mirror(camera, normal, -4.0)
    for factor in (2, 3):
        surfaces, dense = finer(shown, camera, factor)
        assert (dense.width, dense.height) == (factor * WIDTH, factor * HEIGHT)
        origins, directions = dense.rays()
        exact = (-4.0 - origins @ normal) / (directions @ normal)
        rows, columns = (slice(factor, factor * size - factor) for size in (HEIGHT, WIDTH))
        torch.testing.assert_close(surfaces.depth[rows, columns], exact[rows, columns], rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(surfaces.normal, (0.5 * normal).expand(factor * HEIGHT, factor * WIDTH, 3))
        assert torch.equal(surfaces.alpha, torch.ones(factor * HEIGHT, factor * WIDTH))


def test_where_nothing_is_hit_nothing_is_between_pixels_either():
    shown = mirror(make_camera(), torch.tensor([0.0, 0.0, -1.0]), -4.0)
    shown.alpha[:, :10], shown.depth[:, :10], shown.normal[:, :10] = 0, 0, 0
    surfaces, _ = finer(shown, make_camera(), 2)
    assert not surfaces.alpha[:, :19].any()
    assert not surfaces.depth[:, :19].any()
    assert (surfaces.depth[:, 19:] > 3).all()  # at the edge too: what is not there has no depth to be mixed with
    assert surfaces.depth.isfinite().all()


def test_one_ray_a_pixel_changes_nothing():
    camera = make_camera()
    shown = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    assert finer(shown, camera, 1) == (shown, camera)
    values = torch.rand(4, 6, 2)
    assert averaged(values, 1) is values
    assert repeated(values, 1) is values


@pytest.mark.parametrize("factor", [2, 3])
def test_points_are_averaged_over_their_pixels(factor):
    values = torch.rand(4 * factor, 5 * factor, 3)
    expected = block_reduce(values.numpy(), (factor, factor, 1), np.mean)
    np.testing.assert_allclose(averaged(values, factor).numpy(), expected, rtol=1e-6)
    few = torch.rand(4, 5, 3)
    assert torch.equal(repeated(few, factor), torch.from_numpy(np.kron(few, np.ones((factor, factor, 1)))).float())


def test_what_is_between_pixels_passes_gradients_on():
    generator = torch.Generator().manual_seed(0)
    camera = make_camera().resized(4, 3)
    camera = replace(camera, world_to_camera=camera.world_to_camera.double(), intrinsics=camera.intrinsics.double())

    def maps(alpha: Tensor, depth: Tensor, normal: Tensor, beta: Tensor) -> tuple[Tensor, ...]:
        hits = torch.ones(3, 4, dtype=torch.int32)
        image = Rendering(normal, alpha, depth, normal, beta, hits, Statistics(torch.zeros(0)))
        surfaces, _ = finer(image, camera, 2)
        return surfaces.alpha, surfaces.depth, surfaces.normal, surfaces.extras

    shapes = ((3, 4), (3, 4), (3, 4, 3), (3, 4, 1))
    inputs = [0.5 + torch.rand(shape, generator=generator, dtype=torch.float64) for shape in shapes]
    assert torch.autograd.gradcheck(maps, [x.requires_grad_() for x in inputs])


def test_a_mirror_ball_comes_nearer_to_what_its_pixels_average(monkeypatch):
    """The truth is the mean of 16×16 exact points a pixel. Four rays leave less than half of one ray's error."""
    size, fine = 24, 16
    truth = torch.from_numpy(block_reduce(picture(1, size * fine, monkeypatch).numpy(), (fine, fine, 1), np.mean))
    errors = [float((picture(factor, size, monkeypatch) - truth).square().mean()) for factor in (1, 2)]
    assert errors[0] > 1e-3  # one ray a pixel is far off
    assert errors[1] < 0.5 * errors[0]


def test_the_environment_counts_pixels_however_many_rays_they_have():
    """What growth and pruning ask of its weights is in pixels: four rays a pixel leave their sum as it was."""
    weights = []
    for factor in (1, 2):
        method = create_method("envgs", {"backend": "cpu", **SMALL["envgs"], "supersampling": factor})
        scene = ball_scene()
        method.initialize(scene, 100)
        begin(method, 60)
        statistics = method.draw(scene.train[0].camera, 60)[1]
        weights.append(float(statistics["env"].weights.sum()))
    assert weights[0] > 10
    assert weights[1] == pytest.approx(weights[0], rel=0.1)


@pytest.mark.parametrize("kind", ["envgs", "envgs_single_set", "envmap", "3dgs_dr", "ref_gaussian"])
def test_every_reflective_method_learns_by_several_rays_a_pixel(kind):
    method = create_method(kind, {"backend": "cpu", **SMALL[kind], "supersampling": 2})
    scene = ball_scene()
    method.initialize(scene, 60)
    losses = [method.training_step(scene.train[0], step)["loss"] for step in range(1, 61)]
    assert torch.stack(losses).isfinite().all()
    assert float(losses[-1]) < float(losses[0])
    image = method.render(scene.train[0].camera)
    assert image.color.shape == (HEIGHT, WIDTH, 3)
    assert image.layers["reflection"].shape == (HEIGHT, WIDTH, 3)
    assert image.layers["reflection"].any()


def test_no_ray_a_pixel_is_refused():
    with pytest.raises(ValueError, match="supersampling is 0, expected greater than or equal to 1"):
        create_method("envgs", {"supersampling": 0})


def ball_scene() -> Scene:
    """One view of points on the ball and behind it."""
    generator = torch.Generator().manual_seed(1)
    camera = make_camera()
    image = torch.randint(0, 256, (HEIGHT, WIDTH, 3), generator=generator, dtype=torch.uint8)
    points = CENTER + RADIUS * unit(torch.randn(300, 3, generator=generator))
    return Scene("ball", [View("view", camera, image)], [], points, torch.rand(300, 3, generator=generator))
