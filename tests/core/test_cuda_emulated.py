"""The CUDA kernels where there is no GPU: emulated thread by thread, in more than one order of the threads.

One kind of set only (degree 2, one extra), so that few kernels have to be compiled; `make test-slow` runs the core's
other tests on emulated kernels too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

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
    facing_surfels,
    gradients_of,
    loss_of,
    plain_camera,
    random_rays,
    random_set,
    relative_error,
    tilted_camera,
)
from cuda_emulator.emulator import ORDERS, EmulatedKernels
from oracle import (
    TOLERANCE,
    compare,
    compare_image_color,
    compare_ray_color,
    drawn_with,
    image,
    oracle_image,
    oracle_ray_batch,
    ray_batch,
)
from torch import Tensor

from envgs_bench.bench.tile_lists import tile_list_lengths
from envgs_bench.core import Camera, GaussianSet, Rendering, build_bvh, cuda
from envgs_bench.core.cuda import raster_pass, trace_pass
from envgs_bench.core.differentiable import SetTensors

SHARINGS = pytest.mark.parametrize(
    "sharing",
    [(1, False), (2, False), (1, True), (2, True)],
    ids=["a warp an area", "in pairs", "a block an area", "a block an area in pairs"],
)


@pytest.fixture(params=["descending", "shuffled"])
def backend(request: pytest.FixtureRequest, emulate: Callable[[str], Backend]) -> Backend:
    return emulate(request.param)


def dressed(gaussians: GaussianSet) -> GaussianSet:
    """With coefficients up to degree 2 and one extra, as random_set() has them."""
    missing = 9 - gaussians.sh.shape[1]
    sh = torch.nn.functional.pad(gaussians.sh, (0, 0, 0, missing))
    return replace(gaussians, sh=sh, extras=torch.rand(len(gaussians), 1, generator=torch.Generator().manual_seed(0)))


@pytest.mark.parametrize("low_pass", [True, False], ids=["low-pass", "exact"])
@SHARINGS
@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
def test_images(backend, as_gaussians_3d, sharing, low_pass, monkeypatch):
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    gaussians, keep, expected = oracle_image("many", as_gaussians_3d, low_pass)
    compare(drawn_with(backend, gaussians, image(low_pass), keep, ()), expected, keep)


@SHARINGS
@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
def test_colors_of_images_alone(backend, as_gaussians_3d, sharing, monkeypatch):
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    compare_image_color(backend, "many", as_gaussians_3d)


@SHARINGS
def test_a_tile_with_more_surfels_than_a_block_fetches_at_once(emulate, sharing, monkeypatch):
    """Three batches in each of four tiles; no pixel is near a support's edge. The order where warps run ahead."""
    monkeypatch.setattr(raster_pass, "_sharing", lambda *_: sharing)
    count, camera = 600, plain_camera(20, 18)
    means = torch.stack([torch.zeros(count), torch.zeros(count), 2 + 0.01 * torch.arange(count)], 1)
    surfels = dressed(facing_surfels(means, scale=30.0, opacity=0.01))
    keep = torch.ones(camera.height, camera.width) > 0

    def draw(backend: Backend, leaves: GaussianSet, _: list[Tensor]) -> Rendering:
        return backend.rasterize(leaves, backend.take(camera))

    expected = drawn_with(ORACLE, surfels, draw, keep, ())
    assert (expected[0].hits == count).all()
    for order in ("ascending", "descending"):
        compare(drawn_with(emulate(order), surfels, draw, keep, ()), expected, keep)


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


@pytest.mark.parametrize(
    ("scene", "sh_direction"), [("few", "center"), ("many", "center"), ("opaque", "center"), ("many", "ray")]
)
def test_ray_batches(backend, scene, sh_direction):
    gaussians, rays, expected = oracle_ray_batch(scene, sh_direction)
    keep = torch.ones(len(rays[0])) > 0
    compare(drawn_with(backend, gaussians, ray_batch(sh_direction), keep, rays), expected, keep)


@pytest.mark.parametrize(("scene", "sh_direction"), [("many", "center"), ("opaque", "center"), ("many", "ray")])
def test_colors_of_rays_alone(backend, scene, sh_direction):
    compare_ray_color(backend, scene, sh_direction)


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


@pytest.mark.parametrize("count", [1, 127, 129, 4097])
def test_a_tree_of_any_size_finds_every_hit(backend, count):
    """Below and above a group of leaves, and with three levels: the oracle tries every surfel."""
    surfels = replace(random_set(count, seed=5), scales=torch.full((count, 2), 1.0 / count**0.5))
    rays = random_rays(60)
    with torch.no_grad():
        drawn, expected = (each.trace(*(each.take(x) for x in (surfels, *rays))) for each in (backend, ORACLE))
    same = drawn.hits == expected.hits  # a support's edge may fall to the other side of a ray
    assert same.double().mean() > 0.95
    assert expected.hits.any()
    for name in FIELDS:
        assert relative_error(getattr(drawn, name)[same], getattr(expected, name)[same]) < 1e-4, name


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


def test_color_alone_is_that_of_more_hits_than_a_list_holds(backend):
    count = 130
    depths = torch.stack([torch.zeros(count), torch.zeros(count), 3 + 2.0**-22 * torch.arange(count)], 1)
    surfels = dressed(facing_surfels(depths, 2.0, 0.03))
    rays = torch.zeros(9, 3), torch.tensor([0.0, 0.0, 1.0]) + 0.05 * random_rays(9)[1] * torch.tensor([1.0, 1.0, 0.0])
    color, alpha = backend.trace_color(surfels, *rays)
    expected = backend.trace(surfels, *rays)
    assert torch.equal(alpha, expected.alpha)
    torch.testing.assert_close(color, expected.color, atol=5e-4, rtol=0)


def test_a_refitted_tree_finds_what_a_new_one_does(backend):
    surfels, rays = random_set(300), random_rays(100)
    bvh = build_bvh(surfels, backend="cuda")
    noise = torch.randn(surfels.means.shape, generator=torch.Generator().manual_seed(0))
    moved = replace(surfels, means=surfels.means + 0.05 * noise)
    bvh.handle.refit(SetTensors.of(moved))
    refitted, rebuilt = backend.trace(moved, *rays, bvh=bvh), backend.trace(moved, *rays)
    assert torch.equal(refitted.hits, rebuilt.hits)
    assert torch.equal(refitted.color, rebuilt.color)


@pytest.mark.parametrize("exponent", [-40, -20, 20, 40])
def test_a_scene_of_any_size_is_drawn_alike(backend, exponent):
    """Lengths times a power of two lose nothing. Surfels are packed as 1/scale and a ratio of scales."""
    surfels, (origins, directions), size = random_set(200), random_rays(100), 2.0**exponent
    results = []
    for factor in (1.0, size):
        resized = replace(surfels, means=factor * surfels.means, scales=factor * surfels.scales)
        leaves, own = backend.take(resized), [backend.take(x) for x in (factor * origins, directions)]
        drawn = backend.trace(leaves, *own)
        drawn = replace(drawn, depth=drawn.depth / factor)
        loss_of(drawn).backward()
        results.append((drawn, gradients_of(leaves, origins=own[0], directions=own[1])))
    (one, gradients), (other, other_gradients) = results
    for name in (*FIELDS, "hits"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    for name in ("means", "scales", "origins"):
        other_gradients[name] *= size
    for name, gradient in gradients.items():
        assert gradient.any(), name
        assert relative_error(other_gradients[name], gradient) < 1e-5, name


@pytest.mark.parametrize("scales", [(1e-6, 1e6), (1e6, 1e-6), (1e-6, 1.0), (1e6, 1.0)])
def test_needles_are_hit_where_they_are(backend, scales):
    surfels = dressed(facing_surfels(torch.tensor([[0.0, 0.0, 3.0]])))
    surfels = replace(surfels, scales=torch.tensor([scales]))
    origins = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 6.0]])
    drawn = backend.trace(surfels, origins, torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]]))
    torch.testing.assert_close(drawn.normal, torch.tensor([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]))
    assert drawn.depth.tolist() == [1.5, 1.5]
    wide = torch.tensor(scales) == max(scales)
    aside = torch.cat([wide * max(scales), torch.zeros(1)])
    far = backend.trace(surfels, aside + origins, torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]]))
    torch.testing.assert_close(far.alpha, torch.full((2,), 0.5 * math.exp(-0.5)))


@pytest.mark.parametrize("hide", ["opacity", "scale"])
def test_invisible_surfels_that_share_leaves_with_visible_ones_change_nothing(backend, hide):
    """Rays start at the hidden surfels' very centers: a support of radius 0, or a frame scaled to nothing, is hit."""
    surfels, hidden = random_set(120, seed=3), torch.arange(120) % 3 == 0
    opacities, scales = surfels.opacities.clone(), surfels.scales.clone()
    if hide == "opacity":
        opacities[hidden] = 1 / 255
    else:
        scales[hidden] = torch.inf
    every, visible = replace(surfels, opacities=opacities, scales=scales), surfels.map(lambda x: x[~hidden])
    origins, directions = surfels.means[hidden], random_rays(40)[1]
    one, other = backend.trace(every, origins, directions), backend.trace(visible, origins, directions)
    assert other.hits.any()
    assert torch.equal(one.hits, other.hits)
    assert not one.statistics.weights[hidden].any()
    for name in FIELDS:
        torch.testing.assert_close(getattr(one, name), getattr(other, name), atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("spacing", [0.0, 2.0**-22, 0.01], ids=["coplanar", "a-rounding-apart", "apart"])
def test_more_hits_than_a_list_holds_are_blended_once_each_and_in_order(backend, spacing):
    count, opacity = 130, 0.03
    depths = 3 + spacing * torch.arange(count)
    surfels = dressed(facing_surfels(torch.stack([torch.zeros(count), torch.zeros(count), depths], 1), 2.0, opacity))
    rays = torch.zeros(9, 3), torch.tensor([0.0, 0.0, 1.0]) + 0.05 * random_rays(9)[1] * torch.tensor([1.0, 1.0, 0.0])
    results = []
    for each in (backend, ORACLE):
        leaves, own = each.take(surfels), [each.take(x) for x in rays]
        drawn = each.trace(leaves, *own)
        loss_of(drawn).backward()
        results.append((drawn, gradients_of(leaves, origins=own[0], directions=own[1])))
    (drawn, gradients), (expected, expected_gradients) = results
    assert drawn.hits.tolist() == [count] * 9
    assert relative_error(drawn.statistics.weights, expected.statistics.weights) < TOLERANCE / 10
    for name in FIELDS:
        assert relative_error(getattr(drawn, name), getattr(expected, name)) < TOLERANCE / 10, name
    for name, gradient in gradients.items():
        assert relative_error(gradient, expected_gradients[name]) < TOLERANCE, name


def test_rays_with_more_hits_than_pages_have_the_same_gradients(backend, monkeypatch):
    surfels, rays = random_set(300), random_rays(200)

    def gradients() -> dict[str, Tensor]:
        leaves, own = backend.take(surfels), [backend.take(x) for x in rays]
        loss_of(backend.trace(leaves, *own)).backward()
        return gradients_of(leaves, origins=own[0], directions=own[1])

    expected = gradients()
    monkeypatch.setattr(trace_pass, "SPARE_PAGES", 3)
    monkeypatch.setattr(trace_pass, "_latest_pages", {torch.device("cpu"): 0.0})
    crowded = gradients()
    assert trace_pass._latest_pages[torch.device("cpu")] > 0.1
    for name, gradient in crowded.items():
        assert relative_error(gradient, expected[name]) < 1e-5, name


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


# What the emulator itself has to notice.

FAULTY = """
extern "C" __global__ void race(float* out) {
    __shared__ float shared[64];
    shared[threadIdx.x] = threadIdx.x;
    out[threadIdx.x] = shared[(threadIdx.x + 1) % 64];
}
extern "C" __global__ void outside(float* out, int at) {
    __shared__ float shared[64];
    shared[threadIdx.x] = 1.0f;
    out[threadIdx.x] = shared[threadIdx.x + at];
}
extern "C" __global__ void unaligned(float* out, int at) { *reinterpret_cast<float4*>(out + at) = {}; }
extern "C" __global__ void __launch_bounds__(64) divergent(float* out) {
    if (threadIdx.x % 32 < 7) __syncwarp();
    out[threadIdx.x] = __ballot_sync(~0u, true);
}
extern "C" __global__ void stuck(float* out) {
    if (threadIdx.x == 3) __syncthreads();
    __syncwarp();
}
extern "C" __global__ void endless(float* out) {
    while (__any_sync(~0u, out[0] >= 0.0f)) continue;
}
extern "C" __global__ void astray(float* out, int at) { out[long(at) << 40] = 1.0f; }
extern "C" __global__ void reused(float* out) {
    __shared__ float shared[2];
    for (int round = 0; round < 3; ++round) {
        if (threadIdx.x % 32 == 0) shared[threadIdx.x / 32] = round;
        __syncthreads();
        out[threadIdx.x] += shared[1 - threadIdx.x / 32] - round;
    }
}
extern "C" __global__ void stale(float* out) {
    __shared__ float shared[64];
    if (blockIdx.x == 0) shared[threadIdx.x] = 1.0f;
    out[threadIdx.x] = shared[threadIdx.x];
}
"""


@pytest.fixture
def faulty(emulate, tmp_path) -> Callable[[str], EmulatedKernels]:
    (tmp_path / "faulty.cu").write_text(FAULTY)
    return lambda order: EmulatedKernels(
        (str(tmp_path / "faulty.cu"),), torch.device("cpu"), builds=tmp_path, order=order
    )


HALVES = """
#include "half.cuh"
using namespace envgs;
extern "C" __global__ void halved(const float* values, float* out) {
    float2 pair = floats_of(halves_of(values[2 * threadIdx.x], values[2 * threadIdx.x + 1]));
    out[2 * threadIdx.x] = pair.x, out[2 * threadIdx.x + 1] = pair.y;
}
"""


@pytest.mark.usefixtures("emulate")
def test_halves_are_rounded_as_elsewhere(tmp_path):
    """Every half, and what lies on either side of the middle between two."""
    (tmp_path / "halves.cu").write_text(HALVES)
    source, device = str(tmp_path / "halves.cu"), torch.device("cpu")
    launch = EmulatedKernels((source,), device, builds=tmp_path, order="ascending")
    halves = torch.arange(1 << 16, dtype=torch.int32).to(torch.int16).view(torch.float16).float()
    halves = halves[halves.isfinite()]
    between = (halves[:-1] + halves[1:]) / 2
    for values in (halves, between, between.nextafter(halves[1:]), between.nextafter(halves[:-1])):
        for some in values[: len(values) // 512 * 512].reshape(-1, 512).contiguous():
            out = torch.empty(512)
            launch("halved", 1, 256, some, out)
            assert torch.equal(out, some.half().float())


def test_mistakes_in_a_kernel_are_noticed(faulty):
    launch, out = faulty("ascending"), torch.zeros(64)
    for name, arguments, message in [
        ("outside", (1,), r"faulty.cu:10: index 64 is outside"),
        ("unaligned", (1,), r"is not aligned|outside all memory"),  # as GCC says, and as Clang's faster load does
        ("divergent", (), r"different operations"),
        ("stuck", (), r"deadlock"),
        ("astray", (1,), r"outside all memory"),
        ("endless", (), r"does not end"),
        ("outside", (1.0,), r"takes parameters pi, launched with pf"),
    ]:
        with pytest.raises(AssertionError, match=message):
            launch(name, 1, 64, out, *arguments)
        launch("outside", 1, 64, out, 0)  # and the next launch is a fresh one
        assert (out == 1).all()
    launch("stale", 2, 64, out)
    assert out.isnan().all()


def test_a_race_shows_in_the_order_of_the_threads(faulty):
    results = []
    for order in ORDERS:
        results.append(torch.zeros(64))
        faulty(order)("race", 1, 64, results[-1])
    assert results[1][:63].tolist() == list(range(1, 64))
    assert results[0].isnan().sum() == 63
    assert not torch.equal(results[2].nan_to_num(), results[1].nan_to_num())


def test_a_warp_that_runs_ahead_shows_that_a_barrier_is_missing(faulty):
    """It writes for the next round before the other warp has read."""
    for order in ("ascending", "descending"):
        out = torch.zeros(64)
        faulty(order)("reused", 1, 64, out)
        assert out.any()


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
