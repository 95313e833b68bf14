"""What only the GPU backend can get wrong: room for lists that are sized ahead, compiling, capture, alignment."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import (
    FIELDS,
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
    steady,
    tilted_camera,
    traced,
)

from envgs_bench.core import Camera, GaussianSet, rasterize, trace, trace_color
from envgs_bench.core import cuda as backend
from envgs_bench.core.cuda.layout import CONSTANTS
from envgs_bench.core.ssim import ssim_map

SIZES = tuple((name, str(value)) for name, value in CONSTANTS.items())
REASON = backend.why_unavailable()
pytestmark = pytest.mark.skipif(REASON is not None, reason=f"backend cuda: {REASON}")


@pytest.fixture
def surfels() -> GaussianSet:
    return random_set(500).map(lambda x: x.cuda().requires_grad_())


@pytest.fixture
def rays() -> tuple[torch.Tensor, torch.Tensor]:
    origins, directions = random_rays(3000)
    return origins.cuda().requires_grad_(), directions.cuda().requires_grad_()


def test_an_image_with_more_instances_than_room_is_drawn_again(surfels, monkeypatch):
    from envgs_bench.core.cuda import raster_pass

    camera = plain_camera(97, 65).to("cuda")
    expected = rasterize(surfels, camera)
    monkeypatch.setattr(raster_pass, "MIN_CAPACITY", 16)
    monkeypatch.setattr(raster_pass, "_latest_instances", {surfels.device: 0})
    drawn = rasterize(surfels, camera)
    for name in (*FIELDS, "hits"):
        assert torch.equal(getattr(drawn, name), getattr(expected, name)), name
    assert relative_error(drawn.statistics.weights, expected.statistics.weights) < 1e-6
    assert raster_pass._latest_instances[surfels.device] > 16


def test_rays_with_more_hits_than_pages_have_the_same_gradients(surfels, rays, monkeypatch):
    from envgs_bench.core.cuda import trace_pass

    def gradients() -> dict[str, torch.Tensor]:
        for leaf in (*vars(surfels).values(), *rays):
            leaf.grad = None
        loss_of(trace(surfels, *rays)).backward()
        return gradients_of(surfels, origins=rays[0], directions=rays[1])

    expected = gradients()
    monkeypatch.setattr(trace_pass, "SPARE_PAGES", 3)
    monkeypatch.setattr(trace_pass, "_latest_pages", {surfels.device: 0.0})
    crowded = gradients()
    assert trace_pass._latest_pages[surfels.device] > 0
    for name, gradient in crowded.items():
        assert relative_error(gradient, expected[name]) < 1e-5, name


def test_what_cannot_fit_is_refused_before_it_is_tried():
    count = 100_000
    wall = facing_surfels(torch.tensor([[0.0, 0.0, 2.0]]).expand(count, 3), scale=100.0).map(lambda x: x.cuda())
    with pytest.raises(torch.OutOfMemoryError, match=r"pairs of a primitive and a tile"):
        rasterize(wall, plain_camera(8000, 8000).to("cuda"))


def test_a_cache_that_cannot_be_written_is_no_error(monkeypatch, tmp_path):
    from envgs_bench.core.cuda.compiler import compile_kernels

    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path / "file"))
    code = compile_kernels.__wrapped__(("radix_sort.cu",), SIZES, torch.cuda.current_device())
    assert code.get_kernel("radix_pass") is not None


def test_the_cache_is_found_again(monkeypatch, tmp_path):
    from envgs_bench.core.cuda.compiler import compile_kernels

    monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path))
    for _ in range(2):
        compile_kernels.__wrapped__(("radix_sort.cu",), SIZES, torch.cuda.current_device())
    assert len(list((tmp_path / "kernels").iterdir())) == 1


def test_drawing_can_be_captured_in_a_graph(surfels, rays):
    camera = plain_camera(97, 65).to("cuda")
    surfels, rays = surfels.map(torch.Tensor.detach), [x.detach() for x in rays]
    image, ray_batch = rasterize(surfels, camera), trace(surfels, *rays)  # compiles, and learns how much room is needed
    color = trace_color(surfels, *rays)[0]
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        captured_image, captured_ray_batch = rasterize(surfels, camera), trace(surfels, *rays)
        captured_color = trace_color(surfels, *rays)[0]
    captured_image.color.zero_(), captured_color.zero_()
    for _ in range(2):
        graph.replay()
    torch.cuda.synchronize()
    for drawn, expected in ((captured_image, image), (captured_ray_batch, ray_batch)):
        for name in (*FIELDS, "hits"):
            assert torch.equal(getattr(drawn, name), getattr(expected, name)), name
    assert torch.equal(captured_color, color)


def test_rows_that_begin_anywhere_are_read_right(surfels, rays):
    camera = plain_camera(97, 65).to("cuda")

    def shifted(x: torch.Tensor) -> torch.Tensor:
        whole = torch.empty(x.numel() + 1, device="cuda")
        whole[1:] = x.detach().flatten()
        return whole[1:].view(x.shape)

    moved = surfels.map(shifted)
    assert moved.quaternions.data_ptr() % 16 != 0
    assert torch.equal(rasterize(moved, camera).color, rasterize(surfels, camera).color)
    assert torch.equal(trace(moved, *rays).color, trace(surfels, *rays).color)


def test_a_camera_made_on_the_gpu_is_checked():
    with pytest.raises(ValueError, match="not a rotation"):
        Camera(2 * torch.eye(4, device="cuda"), torch.eye(3, device="cuda"), 4, 4)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1024, 1025, 40_000])
def test_every_size_of_tree_finds_the_same_hits(count):
    """Around the sizes where a level is added, against the hits of steady rays found by testing every surfel."""
    surfels = replace(random_set(count, degree=0, extras=0), scales=torch.full((count, 2), 0.5 / count**0.5))
    origins, directions = random_rays(200)
    keep = steady(surfels, traced(surfels, origins, directions))
    assert keep.double().mean() > 0.8
    rays = origins[keep], directions[keep]
    on_gpu = trace(surfels.to("cuda"), *(x.cuda() for x in rays))
    slow = trace(surfels.to(torch.float64), *(x.double() for x in rays), backend="torch")
    assert torch.equal(on_gpu.hits.cpu(), slow.hits)
    assert (on_gpu.alpha.cpu() - slow.alpha).abs().max() < 1e-4


def test_the_rays_that_an_image_reflects_are_those_of_the_formula():
    camera = plain_camera(97, 65).to("cuda")
    base = rasterize(random_set(300, extras=1).map(lambda x: x.cuda()), camera)
    for beta_min in (0.05, torch.tensor([0.4], device="cuda")):
        assert_reflected_as_by_formula(backend.reflect, base, camera, beta_min)


def test_normals_of_a_depth_map_are_those_of_the_formula():
    camera = tilted_camera(97, 65).to("cuda")
    depth = rasterize(random_set(300, extras=1).map(lambda x: x.cuda()), camera).depth
    assert_depth_normals_as_by_formula(backend.depth_normals, depth, camera)


def test_similarity_is_that_of_the_formula():
    assert_similar_as_by_formula(backend.ssim_map, "cuda")


@pytest.mark.parametrize("padding", ["zero", "valid"])
def test_similarity_and_its_gradient_are_those_of_the_cpu(padding):
    generator = torch.Generator().manual_seed(0)
    image, target = (torch.rand(70, 53, 3, generator=generator) for _ in range(2))
    maps, gradients = [], []
    for device in ("cpu", "cuda"):
        leaf = image.to(device, copy=True).requires_grad_()
        maps.append(ssim_map(leaf, target.to(device), padding))
        maps[-1].square().mean().backward()
        gradients.append(leaf.grad.cpu())
    torch.testing.assert_close(maps[1].cpu(), maps[0], atol=1e-4, rtol=0)
    assert relative_error(gradients[1], gradients[0]) < 1e-4


def test_steps_of_adam_are_torchs_on_the_cpu():
    assert_adam_is_torchs("cuda")
