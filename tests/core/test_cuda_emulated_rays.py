"""The CUDA kernels where there is no GPU, tracing rays: emulated thread by thread.

Every kernel runs in two orders of the threads at least, where races show; what only asks for values, in one.
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
    dressed,
    facing_surfels,
    gradients_of,
    loss_of,
    random_rays,
    random_set,
    relative_error,
)
from oracle import (
    TOLERANCE,
    compare,
    compare_ray_color,
    drawn_with,
    oracle_ray_batch,
    ray_batch,
)
from torch import Tensor

from envgs_bench.core.cuda import trace_pass

ONE_ORDER = pytest.mark.parametrize("backend", ["shuffled"], indirect=True)


@pytest.fixture(params=["descending", "shuffled"])
def backend(request: pytest.FixtureRequest, emulate: Callable[[str], Backend]) -> Backend:
    return emulate(request.param)


@pytest.mark.parametrize(
    ("backend", "scene", "sh_direction"),
    [
        ("shuffled", "few", "center"),
        ("descending", "many", "center"),
        ("shuffled", "many", "ray"),
        ("descending", "opaque", "center"),
        ("descending", "sites", "center"),
    ],
    indirect=["backend"],
)
def test_ray_batches(backend, scene, sh_direction):
    gaussians, rays, expected = oracle_ray_batch(scene, sh_direction)
    keep = torch.ones(len(rays[0])) > 0
    compare(drawn_with(backend, gaussians, ray_batch(sh_direction), keep, rays), expected, keep)


@pytest.mark.parametrize(
    ("backend", "scene", "sh_direction"),
    [
        ("descending", "many", "center"),
        ("shuffled", "opaque", "center"),
        ("shuffled", "many", "ray"),
        ("shuffled", "sites", "ray"),
    ],
    indirect=["backend"],
)
def test_colors_of_rays_alone(backend, scene, sh_direction):
    compare_ray_color(backend, scene, sh_direction)


@ONE_ORDER
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


@ONE_ORDER
def test_color_alone_is_that_of_more_hits_than_a_list_holds(backend):
    count = 130
    depths = torch.stack([torch.zeros(count), torch.zeros(count), 3 + 2.0**-22 * torch.arange(count)], 1)
    surfels = dressed(facing_surfels(depths, 2.0, 0.03))
    rays = torch.zeros(9, 3), torch.tensor([0.0, 0.0, 1.0]) + 0.05 * random_rays(9)[1] * torch.tensor([1.0, 1.0, 0.0])
    color, alpha = backend.trace_color(surfels, *rays)
    expected = backend.trace(surfels, *rays)
    assert torch.equal(alpha, expected.alpha)
    torch.testing.assert_close(color, expected.color, atol=5e-4, rtol=0)


@ONE_ORDER
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


@ONE_ORDER
@pytest.mark.parametrize("scales", [(1e-6, 1e6), (1e6, 1e-6), (1e-6, 1.0), (1e6, 1.0)])
def test_elongated_surfels_are_hit_where_they_are(backend, scales):
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


@ONE_ORDER
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


@ONE_ORDER
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


@ONE_ORDER
def test_rays_of_one_packet_end_where_each_of_them_is_to(backend):
    """The number of hits by the closed form, of rays side by side through more of them than a list holds."""
    count, opacity = 200, 0.05
    means = torch.stack([torch.zeros(count), torch.zeros(count), 3 + 0.01 * torch.arange(count)], 1)
    surfels = facing_surfels(means, 2.0, opacity)
    ends = torch.tensor([0.9, 1e-4, 0.3, 0.02, 0.5, 1e-3, 0.1, 2e-4])
    origins, directions = torch.zeros(8, 3), torch.tensor([[0.0, 0.0, 1.0]]).repeat(8, 1)
    drawn = backend.trace(*(backend.take(x) for x in (surfels, origins, directions)), transmittance_min=ends)
    expected = [math.ceil(math.log(end) / math.log(1 - opacity)) for end in ends.tolist()]
    assert drawn.hits.tolist() == expected
    left = 1 - drawn.alpha.detach()
    assert left.tolist() == pytest.approx([(1 - opacity) ** hits for hits in expected], abs=1e-6)


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
