"""The CUDA kernels where there is no GPU, drawing images: emulated thread by thread, in more than one order of them.

One kind of set only (degree 2, one extra), so that few kernels have to be compiled; `make test-slow` runs the core's
other tests on emulated kernels too. What a drawing is made of comes in two orders of the threads, where races show.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from core_scenes import (
    FIELDS,
    ORACLE,
    Backend,
    assert_adam_is_torchs,
    assert_depth_normals_as_by_formula,
    assert_reflected_as_by_formula,
    assert_similar_as_by_formula,
    dressed,
    facing_surfels,
    gradients_of,
    loss_of,
    plain_camera,
    random_rays,
    random_set,
    relative_error,
    tilted_camera,
)
from cuda_emulator.emulator import ORDERS
from oracle import (
    Drawn,
    compare,
    compare_image_color,
    drawn_with,
    image,
    oracle_image,
)
from torch import Tensor

from envgs_bench.bench.tile_lists import tile_list_lengths
from envgs_bench.core import Camera, GaussianSet, Rendering, cuda
from envgs_bench.core.cuda import raster_pass


@pytest.fixture(params=["descending", "shuffled"])
def backend(request: pytest.FixtureRequest, emulate: Callable[[str], Backend]) -> Backend:
    return emulate(request.param)


SHARINGS = pytest.mark.parametrize(
    "sharing",
    [(1, False), (2, False), (1, True), (2, True)],
    ids=["a warp an area", "in pairs", "a block an area", "a block an area in pairs"],
)


@pytest.mark.parametrize(
    ("backend", "low_pass"),
    [("descending", True), ("shuffled", False)],
    indirect=["backend"],
    ids=["low-pass", "exact"],
)
@SHARINGS
@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
def test_images(backend, as_gaussians_3d, sharing, low_pass, monkeypatch):
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    gaussians, keep, expected = oracle_image("many", as_gaussians_3d, low_pass)
    compare(drawn_with(backend, gaussians, image(low_pass), keep, ()), expected, keep)


@pytest.mark.parametrize("backend", ["shuffled"], indirect=True)
def test_images_of_sites(backend):
    gaussians, keep, expected = oracle_image("sites", False, True)
    compare(drawn_with(backend, gaussians, image(True), keep, ()), expected, keep)


@pytest.mark.parametrize("backend", ["shuffled"], indirect=True)
@pytest.mark.parametrize(
    ("as_gaussians_3d", "sharing"),
    [(False, (2, False)), (False, (1, True)), (True, (1, False)), (True, (2, True))],
    ids=["surfels-in pairs", "surfels-a block an area", "gaussians_3d-a warp an area", "gaussians_3d-both"],
)
def test_colors_of_images_alone(backend, as_gaussians_3d, sharing, monkeypatch):
    """Each kind and each way to share; all of both are in `test_images`, of kernels of the same template."""
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    compare_image_color(backend, "many", as_gaussians_3d)


DEEP = plain_camera(20, 18)


def drawn_deep(backend: Backend, leaves: GaussianSet, _: list[Tensor]) -> Rendering:
    return backend.rasterize(leaves, backend.take(DEEP))


@pytest.fixture(scope="module")
def deep() -> tuple[GaussianSet, Drawn]:
    """Three batches in each of four tiles, and what the oracle draws of them; no pixel is near a support's edge."""
    count = 600
    means = torch.stack([torch.zeros(count), torch.zeros(count), 2 + 0.01 * torch.arange(count)], 1)
    surfels = dressed(facing_surfels(means, scale=30.0, opacity=0.01))
    expected = drawn_with(ORACLE, surfels, drawn_deep, torch.ones(DEEP.height, DEEP.width) > 0, ())
    assert (expected[0].hits == count).all()
    return surfels, expected


@SHARINGS
def test_a_tile_with_more_surfels_than_a_block_fetches_at_once(emulate, sharing, deep, monkeypatch):
    """In the order where warps run ahead, too."""
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    surfels, expected = deep
    keep = torch.ones(DEEP.height, DEEP.width) > 0
    for order in ("ascending", "descending"):
        compare(drawn_with(emulate(order), surfels, drawn_deep, keep, ()), expected, keep)


@pytest.mark.parametrize("columns", [2, 3], ids=["surfels", "gaussians_3d"])
def test_position_gradients_of_color(emulate, columns):
    gaussians, camera = random_set(60, columns=columns, seed=3), tilted_camera()
    keep = torch.ones(camera.height, camera.width) > 0

    def draw(backend: Backend, leaves: GaussianSet, _: list[Tensor]) -> Rendering:
        return backend.rasterize(leaves, backend.take(camera), color_statistics=True)

    expected = drawn_with(ORACLE, gaussians, draw, keep, ())
    compare(drawn_with(emulate("shuffled"), gaussians, draw, keep, ()), expected, keep)


def test_a_tiles_list_holds_what_its_pixels_see(emulate):
    """One surfel in the middle of the first tile, and one that covers all four."""
    emulate("shuffled")
    camera = plain_camera(20, 18)
    small, large = (dressed(facing_surfels(unprojected(camera, 8.0, 8.0), s, 0.9)) for s in (1e-3, 30.0))
    assert tile_list_lengths(small, camera, 0.2, "cuda").tolist() == [1, 0, 0, 0]
    assert tile_list_lengths(large, camera, 0.2, "cuda").tolist() == [1, 1, 1, 1]


def unprojected(camera: Camera, x: float, y: float) -> Tensor:
    """The point [1, 3] at depth 2 that a camera without a pose shows at (x, y)."""
    return (camera.intrinsics.inverse() @ torch.tensor([x, y, 1.0]) * 2)[None]


@pytest.mark.parametrize("kind", ["surfels", "gaussians_3d", "rays"])
def test_the_order_of_the_threads_changes_no_bit_of_what_is_drawn(emulate, kind):
    def draw(backend: Backend, leaves: GaussianSet) -> Rendering:
        if kind == "rays":
            return backend.trace(leaves, *random_rays(200))
        return backend.rasterize(leaves, tilted_camera())

    drawn, gradients = [], []
    for order in ORDERS:
        backend = emulate(order)
        leaves = backend.take(random_set(300, columns=3 if kind == "gaussians_3d" else 2))
        drawn.append(draw(backend, leaves))
        loss_of(drawn[-1]).backward()
        gradients.append(gradients_of(leaves))
    for other, other_gradients in zip(drawn[1:], gradients[1:], strict=True):
        for name in (*FIELDS, "hits"):
            assert torch.equal(getattr(other, name), getattr(drawn[0], name)), name
        for name, gradient in other_gradients.items():
            assert relative_error(gradient, gradients[0][name]) < 1e-5, name


@pytest.mark.parametrize("kind", ["image", "rays"])
def test_the_order_of_the_threads_changes_no_bit_of_color_alone(emulate, kind):
    def draw(backend: Backend) -> tuple[Tensor, Tensor]:
        if kind == "rays":
            return backend.trace_color(random_set(300), *random_rays(201))
        return backend.rasterize_color(random_set(300), tilted_camera())

    drawn = [draw(emulate(order)) for order in ORDERS]
    for color, alpha in drawn[1:]:
        assert torch.equal(color, drawn[0][0])
        assert torch.equal(alpha, drawn[0][1])


def test_an_image_with_more_instances_than_room_is_drawn_again(backend, monkeypatch):
    surfels, camera = random_set(300), plain_camera(49, 33)
    expected = backend.rasterize(surfels, camera)
    monkeypatch.setattr(raster_pass, "MIN_CAPACITY", 16)
    monkeypatch.setattr(raster_pass, "_latest_instances", {torch.device("cpu"): 0})
    drawn = backend.rasterize(surfels, camera)
    assert raster_pass._latest_instances[torch.device("cpu")] > 16
    for name in (*FIELDS, "hits"):
        assert torch.equal(getattr(drawn, name), getattr(expected, name)), name
    assert relative_error(drawn.statistics.weights, expected.statistics.weights) < 1e-6


def test_the_rays_that_an_image_reflects_are_those_of_the_formula(backend):
    camera = plain_camera(49, 33)
    base = backend.rasterize(random_set(300), camera)
    for beta_min in (0.05, torch.tensor([0.4])):
        assert_reflected_as_by_formula(cuda.reflect, base, camera, beta_min)


def test_normals_of_a_depth_map_are_those_of_the_formula(backend):
    camera = tilted_camera(49, 33)
    assert_depth_normals_as_by_formula(cuda.depth_normals, backend.rasterize(random_set(300), camera).depth, camera)


def test_similarity_is_that_of_the_formula(backend):
    assert_similar_as_by_formula(cuda.ssim_map, backend.device)


def test_rows_that_begin_anywhere_are_read_right(backend):
    surfels, rays, camera = random_set(100), random_rays(50), plain_camera(33, 17)

    def shifted(x: Tensor) -> Tensor:
        whole = torch.empty(x.numel() + 1)
        whole[1:] = x.flatten()
        return whole[1:].view(x.shape)

    moved = surfels.map(shifted)
    assert moved.quaternions.data_ptr() % 16 != 0
    for draw in (lambda x: backend.rasterize(x, camera), lambda x: backend.trace(x, *rays)):
        leaves = backend.take(surfels), moved.map(lambda x: x.requires_grad_())
        one, other = map(draw, leaves)
        assert torch.equal(one.color, other.color)
        loss_of(other).backward()


@pytest.mark.parametrize("columns", [2, 3])
def test_no_primitive_and_no_ray(backend, columns):
    nothing, camera = backend.take(random_set(0, columns=columns)), plain_camera(17, 9)
    background = torch.tensor([0.2, 0.3, 0.4])
    drawn = [backend.rasterize(nothing, camera, background=background)]
    if columns == 2:
        drawn.append(backend.trace(nothing, *random_rays(5), background=background))
        assert backend.trace(backend.take(random_set(9)), *random_rays(0)).color.shape == (0, 3)
    for each in drawn:
        assert torch.equal(each.color, background.expand_as(each.color))
        loss_of(each).backward()


def test_steps_of_adam_are_torchs(emulate):
    """Sizes that fill no thread, some and the last one only in part; a step that is skipped; a rate that changes."""
    emulate("shuffled")
    assert_adam_is_torchs("cpu")


@pytest.mark.parametrize("pixels", [1, 2])
def test_a_pixel_ends_at_the_same_primitive_however_its_list_is_shared(emulate, pixels, monkeypatch):
    """Five hundred veils, of which a pixel sees half: it ends within a warp's eighth, and at its borders."""
    count, camera = 500, plain_camera(20, 18)
    means = torch.stack([torch.zeros(count), torch.zeros(count), 2 + 0.01 * torch.arange(count)], 1)
    surfels = dressed(facing_surfels(means, scale=3.0, opacity=0.06))
    backend, drawn = emulate("shuffled"), []
    for sharing in ((pixels, False), (pixels, True)):
        monkeypatch.setattr(raster_pass, "_sharing", lambda *_, sharing=sharing: sharing)
        leaves = surfels.map(lambda x: x.clone().requires_grad_())
        rendering = backend.rasterize(leaves, backend.take(camera))
        rendering.color.square().sum().backward()
        drawn.append((rendering, leaves.means.grad))
    (walked, g_walked), (shared, g_shared) = drawn
    assert 100 < int(walked.hits.min()) < int(walked.hits.max()) < count
    assert (walked.hits - shared.hits).abs().max() <= 1  # by rounding of the transmittance at which a pixel ends
    assert (walked.hits == shared.hits).double().mean() > 0.9
    assert relative_error(shared.color, walked.color) < 1e-4
    assert relative_error(shared.statistics.weights, walked.statistics.weights) < 1e-3
    assert relative_error(g_shared, g_walked) < 1e-3
