"""trace: closed forms, ties at and around the sizes of a hit buffer, and its rays' bookkeeping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from core_scenes import colored, facing_surfels, gradients_of, loss_of, random_rays, random_set, relative_error
from scipy.spatial.transform import Rotation

from envgs_bench.core import Rendering, build_bvh


def forward_ray(x: float = 0.0, y: float = 0.0, length: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor([[x, y, 0.0]]), torch.tensor([[0.0, 0.0, length]])


def trace_with(tracer, gaussians, origins, directions, **options):
    return tracer.trace(tracer.take(gaussians), tracer.take(origins), tracer.take(directions), **options)


def test_a_surfel_is_where_its_plane_is_crossed(tracer):
    """Each ray by solving o + t·d = p + u·s_u·t_u + v·s_v·t_v with numpy."""
    gaussians = replace(random_set(1, degree=0, seed=4), opacities=torch.tensor([0.7]))
    origins, directions = random_rays(200)
    directions = gaussians.means + 0.4 * torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) - origins
    rotation = Rotation.from_quat(gaussians.quaternions[0].double().numpy(), scalar_first=True).as_matrix()
    mean, (su, sv) = gaussians.means[0].double().numpy(), gaussians.scales[0].double().tolist()
    expected = np.zeros((200, 5))
    for ray, (o, d) in enumerate(zip(origins.double().numpy(), directions.double().numpy(), strict=True)):
        t, u, v = np.linalg.solve(np.stack([d, -su * rotation[:, 0], -sv * rotation[:, 1]], 1), mean - o)
        rho = u * u + v * v
        if t > 0 and rho <= 9:
            alpha = 0.7 * np.exp(-rho / 2)
            expected[ray] = [alpha, t, *(-np.sign(d @ rotation[:, 2]) * alpha * rotation[:, 2])]

    drawn = trace_with(tracer, gaussians, origins, directions)

    assert 30 < (expected[:, 0] > 0).sum() < 200
    np.testing.assert_allclose(drawn.alpha.detach().cpu(), expected[:, 0], atol=3e-5)
    np.testing.assert_allclose(drawn.depth.detach().cpu(), expected[:, 1], atol=3e-5)
    np.testing.assert_allclose(drawn.normal.detach().cpu(), expected[:, 2:], atol=3e-5)


@pytest.mark.parametrize("opacity", [1.0, 0.5, 0.35, 0.05, 0.01, 0.004])
def test_the_support_ends_where_the_formula_says(tracer, opacity):
    edge = min(9.0, 2 * np.log(255 * opacity)) ** 0.5
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), scale=0.5, opacity=opacity)
    x = torch.tensor([0.99, 1.01, -0.99, -1.01]) * edge * 0.5
    origins = torch.stack([x, torch.zeros(4), torch.zeros(4)], 1)
    drawn = trace_with(tracer, gaussians, origins, torch.tensor([[0.0, 0.0, 1.0]]).expand(4, 3))
    assert drawn.hits.tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize("opacity", [0.0, 1e-3, 1 / 256])
def test_what_cannot_reach_one_part_in_255_is_nowhere_drawn(tracer, opacity):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), opacity=opacity)
    assert not trace_with(tracer, gaussians, *forward_ray()).hits.any()


def test_alpha_never_exceeds_99_hundredths(tracer):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), opacity=1.0)
    assert trace_with(tracer, gaussians, *forward_ray()).alpha.item() == pytest.approx(0.99, abs=1e-6)


def test_distances_are_in_units_of_the_directions_length(tracer):
    gaussians = random_set(60)
    origins, directions = random_rays(50)
    one = trace_with(tracer, gaussians, origins, directions)
    two = trace_with(tracer, gaussians, origins, directions * 2)
    torch.testing.assert_close(two.depth * 2, one.depth, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(two.color, one.color, atol=1e-5, rtol=1e-4)


def test_hits_before_t_min_and_behind_the_origin_are_not_drawn(tracer):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, z] for z in (-2.0, 0.5, 2.0)]))
    ray = forward_ray(length=0.5)  # hits at t = −4, 1 and 4
    assert trace_with(tracer, gaussians, *ray).hits.item() == 2
    late = trace_with(tracer, gaussians, *ray, t_min=1.5)
    assert late.hits.item() == 1
    assert late.depth.item() == pytest.approx(4.0, rel=1e-6)


def test_a_ray_that_starts_on_a_surfel_meets_it_at_zero(tracer):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    drawn = trace_with(tracer, gaussians, *forward_ray(0.1))
    assert drawn.hits.item() == 2
    assert trace_with(tracer, gaussians, *forward_ray(0.1), t_min=1e-3).hits.item() == 1


def test_surfels_are_seen_from_both_sides(tracer):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 2.0]]))
    origins = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 4.0]])
    directions = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    drawn = trace_with(tracer, gaussians, origins, directions)
    expected = torch.tensor([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])
    torch.testing.assert_close(drawn.normal.detach().cpu().float(), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("count", [2, 15, 16, 17, 31, 32, 33, 64, 100])
def test_coplanar_hits_blend_once_each_in_the_order_of_storage(tracer, count):
    """All at one t, each shifted and turned in its plane: Σ and order are those of a written-out loop."""
    generator = torch.Generator().manual_seed(count)
    means = torch.cat([torch.rand(count, 2, generator=generator) - 0.5, torch.full((count, 1), 3.0)], 1)
    half = torch.rand(count, generator=generator) * torch.pi
    colors = torch.rand(count, 3, generator=generator)
    gaussians = replace(
        facing_surfels(means, scale=0.6),
        quaternions=torch.stack([half.cos(), torch.zeros(count), torch.zeros(count), half.sin()], 1),
        opacities=0.03 + 0.05 * torch.rand(count, generator=generator),
        sh=colored(colors),
    )
    left, color = 1.0, np.zeros(3)
    for mean, opacity, own in zip(means.double().numpy(), gaussians.opacities.double().numpy(), colors, strict=True):
        alpha = opacity * np.exp(-(mean[0] ** 2 + mean[1] ** 2) / 0.36 / 2)
        color += left * alpha * own.double().numpy()
        left *= 1 - alpha

    drawn = trace_with(tracer, gaussians, *forward_ray())

    assert drawn.hits.item() == count
    np.testing.assert_allclose(drawn.color[0].detach().cpu(), color, atol=1e-5)
    assert drawn.alpha.item() == pytest.approx(1 - left, abs=1e-5)
    assert drawn.depth.item() == pytest.approx(3.0, abs=1e-5)


@pytest.mark.parametrize("before", [13, 14, 15, 16, 29, 30, 31, 32])
def test_ties_across_the_end_of_a_hit_buffer(tracer, before):
    """`before` hits at distances of their own, then four at one distance, then three more."""
    depths = torch.cat([torch.linspace(1, 2, before), torch.full((4,), 3.0), torch.linspace(4, 5, 3)])
    means = torch.stack([torch.zeros_like(depths), torch.zeros_like(depths), depths], 1)
    gaussians = replace(facing_surfels(means, opacity=0.1), opacities=torch.full((len(depths),), 0.1))
    shuffled = torch.randperm(len(depths), generator=torch.Generator().manual_seed(before))
    colors = torch.rand(len(depths), 3, generator=torch.Generator().manual_seed(0))
    gaussians = replace(gaussians, sh=colored(colors)).map(lambda x: x[shuffled])
    order = sorted(range(len(depths)), key=lambda i: (float(gaussians.means[i, 2]), i))
    weights = 0.1 * 0.9 ** np.arange(len(depths))
    expected = (weights[:, None] * colors[shuffled][order].double().numpy()).sum(0)

    drawn = trace_with(tracer, gaussians, *forward_ray())

    assert drawn.hits.item() == len(depths)
    np.testing.assert_allclose(drawn.color[0].detach().cpu(), expected, atol=1e-5)
    np.testing.assert_allclose(drawn.statistics.weights.cpu()[order], weights, rtol=1e-4)


def test_a_ray_ends_with_the_hit_that_takes_it_below_the_threshold(tracer):
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, z] for z in (6.0, 5, 4, 3, 2, 1)]), opacity=0.9)
    drawn = trace_with(tracer, gaussians, *forward_ray(), transmittance_min=5e-3)
    assert drawn.hits.item() == 3
    assert drawn.alpha.item() == pytest.approx(0.999, abs=1e-5)
    assert trace_with(tracer, gaussians, *forward_ray(), transmittance_min=0.0).hits.item() == 6


def test_each_ray_ends_below_its_own_threshold(tracer):
    """As if those of one threshold were traced by themselves: what they draw, and what all of them differentiate."""
    surfels, rays = random_set(300), random_rays(120)
    thresholds = torch.tensor([1e-4, 0.05, 0.5, 1.0])
    own = thresholds[torch.arange(120) % 4]

    leaves, (origins, directions) = tracer.take(surfels), [tracer.take(x) for x in rays]
    ends = own.to(origins)
    drawn = tracer.trace(leaves, origins, directions, transmittance_min=ends)
    color, alpha = tracer.trace_color(leaves, origins, directions, transmittance_min=ends)
    loss_of(drawn).backward()
    gradients = gradients_of(leaves, origins=origins, directions=directions)

    others, (origins, directions) = tracer.take(surfels), [tracer.take(x) for x in rays]
    parts = [
        tracer.trace(others, origins[k::4], directions[k::4], transmittance_min=float(threshold))
        for k, threshold in enumerate(thresholds)
    ]
    for name in ("color", "alpha", "depth", "normal", "extras", "hits"):
        values = torch.stack([getattr(part, name) for part in parts], dim=1).flatten(0, 1)
        torch.testing.assert_close(getattr(drawn, name), values, atol=1e-6, rtol=1e-5)
    assert (drawn.hits[3::4] <= 1).all()
    assert 0 < drawn.hits[2::4].sum() < drawn.hits[0::4].sum()
    torch.testing.assert_close(color.to(drawn.color), drawn.color.detach(), atol=1e-3, rtol=0)
    torch.testing.assert_close(alpha.to(drawn.alpha), drawn.alpha.detach(), atol=1e-5, rtol=0)
    loss_of(mixed_of(parts)).backward()
    for name, gradient in gradients_of(others, origins=origins, directions=directions).items():
        assert relative_error(gradients[name], gradient) < 1e-4, name


def mixed_of(parts: list[Rendering]) -> Rendering:
    """Batches of rays taken in turn as one."""
    fields = {
        name: torch.stack([getattr(part, name) for part in parts], dim=1).flatten(0, 1)
        for name in ("color", "alpha", "depth", "normal", "extras", "hits")
    }
    return replace(parts[0], **fields)


def test_thresholds_that_are_not_the_rays_are_refused(tracer):
    leaves, (origins, directions) = tracer.take(random_set(3)), [tracer.take(x) for x in random_rays(5)]
    with pytest.raises(ValueError, match=r"transmittance_min is .* \(4,\) .*expected a number, or .* \(5,\)"):
        tracer.trace(leaves, origins, directions, transmittance_min=origins.new_full((4,), 0.1))


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 5), (2, 0, 4), ()])
def test_rays_of_any_leading_shape(tracer, shape):
    origins, directions = (x[: int(np.prod(shape))].reshape(*shape, 3) for x in random_rays(15))
    drawn = trace_with(tracer, random_set(50, extras=3), origins, directions)
    assert drawn.color.shape == drawn.normal.shape == drawn.extras.shape == (*shape, 3)
    assert drawn.alpha.shape == drawn.depth.shape == drawn.hits.shape == shape
    assert drawn.hits.dtype == torch.int32
    assert drawn.statistics.weights.shape == (50,)


def test_an_empty_set_is_background(tracer):
    background = torch.tensor([0.2, 0.4, 0.8])
    drawn = trace_with(tracer, random_set(0, extras=0), *random_rays(7), background=background)
    torch.testing.assert_close(drawn.color.detach().cpu().float(), background.expand(7, 3))
    assert not drawn.alpha.any()
    assert drawn.extras.shape == (7, 0)


def test_a_shared_bvh_changes_nothing(tracer):
    gaussians, rays = tracer.take(random_set(300)), [tracer.take(x) for x in random_rays(100)]
    bvh = build_bvh(gaussians, backend=tracer.name)
    own, shared = tracer.trace(gaussians, *rays), tracer.trace(gaussians, *rays, bvh=bvh)
    for name in ("color", "alpha", "depth", "normal", "extras", "hits"):
        assert torch.equal(getattr(own, name), getattr(shared, name))


def test_more_primitives_than_sixteen_bits_count(tracer):
    """70,000 surfels far off the rays, and one each at both ends of the storage on them."""
    count = 70_000
    means = torch.zeros(count, 3)
    means[:, 2] = 5 + torch.arange(count) * 1e-3
    means[:, 0] = 50
    means[0], means[-1] = torch.tensor([0.0, 0.0, 4.0]), torch.tensor([0.0, 0.0, 3.0])
    gaussians = replace(facing_surfels(means, scale=0.3), sh=colored(torch.zeros(count, 3)))
    drawn = trace_with(tracer, gaussians, *forward_ray())
    assert drawn.hits.item() == 2
    assert drawn.statistics.weights[-1].item() == pytest.approx(0.5, abs=1e-6)


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value encountered")  # embree's spread
@pytest.mark.parametrize("apart", [1e-45, 1e-42, 1.6e36])
def test_distances_that_have_no_inverse_are_as_good_as_others(tracer, apart):
    """Forty surfels in a row so close, or so far apart, that bins of their centers' range have no width in float32."""
    means = torch.zeros(40, 3)
    means[:, 0] = apart * (torch.arange(40) // 20 * 99 + torch.arange(40) % 20)
    means[:, 2] = 3
    drawn = trace_with(tracer, facing_surfels(means, scale=0.3), *forward_ray())
    assert drawn.hits.item() == (1 if apart > 1 else 14)  # at an opacity of 0.5 fourteen end a ray
    assert drawn.depth.item() == pytest.approx(3.0, abs=1e-5)


def test_rays_without_a_direction_meet_nothing(tracer):
    """They have the background's color, cost the others nothing, and leave all gradients finite."""
    surfels, (origins, directions) = random_set(300), random_rays(100)
    standing, background = directions.clone(), tracer.take(torch.tensor([0.2, 0.3, 0.4])).detach()
    standing[::3] = 0
    leaves, own = tracer.take(surfels), [tracer.take(x) for x in (origins, standing)]
    some = tracer.trace(leaves, *own, background=background)
    every = trace_with(tracer, surfels, origins, directions, background=background)
    assert not some.hits[::3].any()
    assert torch.equal(some.color[::3], background.expand_as(some.color[::3]))
    for start in (1, 2):
        assert every.hits[start::3].any()
        torch.testing.assert_close(some.color[start::3], every.color[start::3])
    loss_of(some).backward()
    for name, gradient in gradients_of(leaves, origins=own[0], directions=own[1]).items():
        assert gradient.isfinite().all(), name
