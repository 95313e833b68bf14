"""Mistakes that Gaussian rasterizers and tracers are known to make, one test each."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import (
    FIELDS,
    ORACLE,
    colored,
    facing_surfels,
    gradients_of,
    loss_of,
    plain_camera,
    random_rays,
    random_set,
    relative_error,
    tilted_camera,
)

from envgs_bench.core import Camera, GaussianSet


def joined(*sets: GaussianSet) -> GaussianSet:
    names = [name for name, value in vars(sets[0]).items() if value is not None]
    return GaussianSet(**{name: torch.cat([getattr(each, name) for each in sets]) for name in names})


@pytest.mark.parametrize("columns", [2, 3])
def test_culled_primitives_stored_first_change_nothing(rasterizer, columns):
    """Behind the camera, before the near plane, beside the image and invisible: each once, in front of the others."""
    visible, camera = random_set(40, columns=columns, seed=1), rasterizer.take(tilted_camera())
    hidden = replace(
        random_set(4, columns=columns, seed=2),
        means=torch.tensor([[0.0, 0.0, -4.0], [0.0, 0.0, 0.1], [90.0, 0.0, 3.0], [0.0, 0.0, 4.0]]),
        scales=torch.full((4, columns), 0.01),
        opacities=torch.tensor([0.9, 0.9, 0.9, 0.001]),
    )
    alone, both = rasterizer.take(visible), rasterizer.take(joined(hidden, visible))
    one, other = rasterizer.rasterize(alone, camera), rasterizer.rasterize(both, camera)
    loss_of(one).backward()
    loss_of(other).backward()

    for name in FIELDS:
        torch.testing.assert_close(getattr(other, name), getattr(one, name), atol=1e-6, rtol=1e-5)
    gradients = gradients_of(both)
    for name, expected in gradients_of(alone).items():
        assert relative_error(gradients[name][4:], expected) < 1e-5, name
        assert not gradients[name][:4].any(), name
    assert not other.statistics.weights[:4].any()
    assert not other.statistics.position_gradients[:4].any()


def test_env_only_rays_train_every_field(tracer):
    """Rays that hit one set only, none of a camera's: a step along a field's gradient changes the loss as it says."""
    gaussians = replace(
        random_set(1, degree=1, seed=3),
        means=torch.tensor([[0.0, 0.0, 4.0]]),
        quaternions=torch.tensor([[1.0, 0.1, -0.2, 0.3]]),
        scales=torch.tensor([[0.6, 0.3]]),
        opacities=torch.tensor([0.6]),
    )
    origins, _ = random_rays(60)
    origins = origins[(origins[:, 2] - 4).abs() > 2]
    leaves = tracer.take(gaussians)
    rays = [tracer.take(origins).detach(), tracer.take(torch.tensor([0.1, 0.05, 4.0]) - origins).detach()]
    loss_of(tracer.trace(leaves, *rays)).backward()
    for name in ("opacities", "scales", "quaternions", "means", "sh", "extras"):
        gradient = getattr(leaves, name).grad
        size = gradient.norm()
        assert size > 1e-3, name
        step = 1e-3 * gradient / size
        after, before = (
            loss_of(tracer.trace(replace(leaves, **{name: getattr(leaves, name) + s * step}), *rays)) for s in (1, -1)
        )
        assert (after - before).item() == pytest.approx(2e-3 * size.item(), rel=0.02, abs=1e-5), name


def test_the_background_counts_once_in_the_gradient_of_alpha(tracer):
    """With a background equal to the surfel's color, its opacity cannot matter."""
    gaussians = replace(
        facing_surfels(torch.tensor([[0.0, 0.0, 3.0], [0.1, 0.0, 4.0]])), sh=colored(torch.full((2, 3), 0.7))
    )
    leaves = tracer.take(gaussians)
    ray = tracer.take(torch.zeros(1, 3)), tracer.take(torch.tensor([[0.05, 0.0, 1.0]]))
    drawn = tracer.trace(leaves, *ray, background=torch.full((3,), 0.7))
    drawn.color.sum().backward()
    assert leaves.opacities.grad.abs().max() < 1e-6
    assert leaves.means.grad.abs().max() < 1e-6


@pytest.mark.parametrize("low_pass", [True, False])
def test_depth_varies_across_a_tilted_surfel(rasterizer, low_pass):
    """A plane at 60° through (0, 0, 4): z = 4/(1 − tan 60°·x)."""
    half = torch.tensor(torch.pi / 6)
    gaussians = replace(
        facing_surfels(torch.tensor([[0.0, 0.0, 4.0]]), scale=0.8),
        quaternions=torch.tensor([[half.cos(), 0.0, half.sin(), 0.0]]),
    )
    camera = plain_camera()
    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(camera), low_pass=low_pass)
    x = camera.rays()[1][16, :, 0]
    expected = 4 / (1 + 3**0.5 * x)
    seen = drawn.alpha[16].cpu() > 0
    if low_pass:
        seen[15:18] = False  # under the filter the pixels around the center have the center's depth
    assert seen.sum() > 8
    torch.testing.assert_close(drawn.depth[16].detach().cpu().float()[seen], expected[seen], atol=1e-4, rtol=1e-4)
    assert expected[seen].max() - expected[seen].min() > 1


@pytest.mark.parametrize("center_z", [0.0, -0.5, 0.3])
@pytest.mark.parametrize("low_pass", [True, False])
def test_a_surfel_that_straddles_the_camera_plane_is_drawn_where_it_is_ahead(rasterizer, center_z, low_pass):
    """A floor under the camera: pixels below the horizon see it at z = height/y, until the support ends."""
    half = torch.tensor(torch.pi / 4)
    gaussians = replace(
        facing_surfels(torch.tensor([[0.0, 1.0, center_z]]), scale=1.5, opacity=0.8),
        quaternions=torch.tensor([[half.cos(), half.sin(), 0.0, 0.0]]),  # normal along y
    )
    leaves, camera = rasterizer.take(gaussians), plain_camera(33, 33, focal=12.0)
    drawn = rasterizer.rasterize(leaves, rasterizer.take(camera), low_pass=low_pass)

    _, directions = camera.rays()
    x, y = directions[..., 0], directions[..., 1]
    t = torch.where(y > 0, 1 / y, -1)
    rho = ((t * x) ** 2 + (t - center_z) ** 2) / 1.5**2
    expected = torch.where((t >= 0.2) & (rho <= 9), 0.8 * (-rho / 2).exp(), 0)
    clear = (rho - 9).abs() > 1e-3
    if low_pass and center_z >= 0.2:
        center = camera.project(gaussians.means)[0][0]
        rows, columns = torch.meshgrid(torch.arange(33) + 0.5, torch.arange(33) + 0.5, indexing="ij")
        clear &= (columns - center[0]) ** 2 + (rows - center[1]) ** 2 > 4.5
    assert (expected > 0).sum() > 100
    torch.testing.assert_close(drawn.alpha.detach().cpu().float()[clear], expected[clear], atol=1e-4, rtol=0)
    loss_of(drawn).backward()
    for name, gradient in gradients_of(leaves).items():
        assert gradient.isfinite().all(), name


def edge_on(x: float = 0.0) -> GaussianSet:
    """A surfel whose plane holds the z axis and, at x = 0, the origin."""
    half = torch.tensor(torch.pi / 4, dtype=torch.float64)
    quaternion = torch.tensor([[half.cos(), 0.0, half.sin(), 0.0]]).float()
    return replace(facing_surfels(torch.tensor([[x, 0.0, 3.0]]), opacity=0.8), quaternions=quaternion)


def test_an_edge_on_surfel_is_a_dot_under_the_filter_and_nothing_without(rasterizer):
    leaves, camera = rasterizer.take(edge_on()), rasterizer.take(plain_camera())
    filtered = rasterizer.rasterize(leaves, camera)
    rows, columns = torch.meshgrid(torch.arange(33.0) - 16, torch.arange(33.0) - 16, indexing="ij")
    squared = columns**2 + rows**2
    expected = torch.where(2 * squared <= 9, 0.8 * (-squared).exp(), 0)
    torch.testing.assert_close(filtered.alpha[:, :16].detach().cpu().float(), expected[:, :16], atol=1e-3, rtol=0)
    assert filtered.depth[16, 16].item() == pytest.approx(3, abs=1e-4)
    loss_of(filtered).backward()
    for name, gradient in gradients_of(leaves).items():
        assert gradient.isfinite().all(), name


def test_an_edge_on_surfel_is_missed_by_rays_in_and_along_its_plane(tracer):
    """One stored exactly: a rotation by 120° about (1, 1, 1) turns the normal to x, with no rounding."""
    gaussians = replace(edge_on(), quaternions=torch.tensor([[0.5, 0.5, 0.5, 0.5]]))
    leaves = tracer.take(gaussians)
    origins = tracer.take(torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0]]))
    directions = tracer.take(torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.1, 1.0]]))
    drawn = tracer.trace(leaves, origins, directions)
    assert not drawn.hits.any()
    loss_of(drawn).backward()
    for name, gradient in gradients_of(leaves, origins=origins, directions=directions).items():
        assert gradient.isfinite().all(), name


@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("shift", [(9, 0), (-7, 4), (13, -13)])
def test_an_off_center_principal_point_shifts_the_picture(rasterizer, columns, shift):
    """Moving the principal point by whole pixels is cropping a larger picture.

    All centers are in both pictures: where it is linearized, a 3D Gaussian depends on the picture's extent.
    """
    scene = random_set(60, columns=columns, seed=4)
    scene = replace(scene, means=scene.means * torch.tensor([0.1, 0.1, 1.0]))
    gaussians, large = rasterizer.take(scene), plain_camera(96, 96, focal=40.0)
    x, y = shift
    intrinsics = large.intrinsics.clone()
    intrinsics[:2, 2] = torch.tensor([16.0 + x, 16.0 + y])
    small = Camera(large.world_to_camera, intrinsics, 32, 32)

    whole = rasterizer.rasterize(gaussians, rasterizer.take(large)).color
    part = rasterizer.rasterize(gaussians, rasterizer.take(small)).color

    crop = whole[32 - y : 64 - y, 32 - x : 64 - x]
    assert crop.any()
    different = (part - crop).abs().amax(-1) > 1e-4
    assert different.double().mean() < 5e-3  # a support's edge may fall to the other side of a pixel center


@pytest.mark.parametrize("side", ["front", "back"])
def test_a_hit_is_never_lost_or_blended_twice_where_many_overlap(tracer, side):
    """Forty nearly coincident surfels, a float32 rounding apart, from both sides."""
    depths = 3 + torch.arange(40) * 2.0**-22
    means = torch.stack([torch.zeros(40), torch.zeros(40), depths], 1)
    leaves = tracer.take(facing_surfels(means, opacity=0.05))
    z = 1.0 if side == "front" else -1.0
    origins, directions = torch.tensor([[0.01, 0.02, 3 - 3 * z]]), torch.tensor([[0.0, 0.0, z]])
    drawn = tracer.trace(leaves, tracer.take(origins), tracer.take(directions))
    assert drawn.hits.item() == 40
    alpha = 0.05 * torch.tensor(-(0.01**2 + 0.02**2) / 0.5, dtype=torch.float64).exp().item()
    assert drawn.alpha.item() == pytest.approx(1 - (1 - alpha) ** 40, rel=1e-5)
    weights, _ = drawn.statistics.weights.sort(descending=True)
    torch.testing.assert_close(
        weights.cpu().double(), alpha * (1 - alpha) ** torch.arange(40, dtype=torch.float64), atol=1e-6, rtol=1e-4
    )


@pytest.mark.parametrize("hide", ["opacity", "scale"])
def test_an_invisible_surfel_stays_so_beside_visible_ones(native, hide):
    """A ray starts at its very center, so that even a support of radius 0, or a frame scaled to nothing, is hit."""
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 1.9], [0.1, 0.0, 2.1]]), opacity=0.6)
    if hide == "opacity":
        gaussians.opacities[0] = 1 / 255
    else:
        gaussians.scales[0] = torch.inf
    leaves = native.take(gaussians)
    origins, directions = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]]).expand(2, 3)
    drawn = native.trace(leaves, native.take(origins), native.take(directions))
    assert drawn.hits.tolist() == [1, 2]
    assert drawn.statistics.weights[0] == 0


@pytest.mark.parametrize("columns", [2, 3])
def test_the_forward_pass_does_not_change_its_input(rasterizer, columns):
    gaussians = random_set(30, columns=columns)
    leaves = rasterizer.take(gaussians)
    loss_of(rasterizer.rasterize(leaves, rasterizer.take(tilted_camera()))).backward()
    for name, value in vars(rasterizer.take(gaussians)).items():
        assert torch.equal(getattr(leaves, name), value), name


@pytest.mark.parametrize("columns", [2, 3])
def test_one_backward_pass_does_not_disturb_another(rasterizer, columns):
    """Two pictures of one set, differentiated in the other order, each by its own upstream gradient."""
    gaussians, camera = random_set(40, columns=columns), rasterizer.take(tilted_camera())
    leaves = rasterizer.take(gaussians)
    values = list(vars(leaves).values())
    first, second = rasterizer.rasterize(leaves, camera), rasterizer.rasterize(leaves, camera, near=3.5)
    of_second = torch.autograd.grad(loss_of(second), values)
    of_first = torch.autograd.grad(loss_of(first), values)
    again = torch.autograd.grad(loss_of(rasterizer.rasterize(leaves, camera)), values)
    for one, other, different in zip(of_first, again, of_second, strict=True):
        torch.testing.assert_close(one, other)
        assert not torch.equal(one, different)


def test_a_ray_from_a_surfels_own_center_has_a_color_and_gradients(tracer):
    """There is no direction to look its color up in: Y of the zero vector, and nothing to differentiate."""
    gaussians = replace(random_set(3, degree=3, seed=8), opacities=torch.full((3,), 0.6))
    results = []
    for each in (tracer, ORACLE):
        leaves = each.take(gaussians)
        origins, directions = each.take(gaussians.means), each.take(torch.tensor([[0.2, 0.5, 1.0]]).expand(3, 3))
        drawn = each.trace(leaves, origins, directions)
        assert (drawn.hits >= 1).all()
        loss_of(drawn).backward()
        results.append((drawn, gradients_of(leaves, origins=origins, directions=directions)))
    (drawn, gradients), (expected, expected_gradients) = results
    assert relative_error(drawn.color, expected.color) < 1e-5
    for name, gradient in gradients.items():
        assert relative_error(gradient, expected_gradients[name]) < 1e-3, name


@pytest.mark.parametrize("columns", [2, 3])
def test_a_color_that_is_no_number_is_seen_in_the_picture(rasterizer, columns):
    """Clamped to black, it would be hidden from whoever looks for losses that are not finite. It may spread."""
    gaussians, camera = random_set(40, columns=columns, degree=1, seed=1), plain_camera()
    gaussians.sh[7] = torch.nan
    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(camera)).color
    expected = ORACLE.rasterize(ORACLE.take(gaussians), ORACLE.take(camera)).color
    assert expected.isnan().any()
    assert drawn.isnan().cpu()[expected.isnan()].all()


def test_a_color_that_is_no_number_is_seen_along_rays(tracer):
    gaussians, (origins, directions) = random_set(60, seed=4), random_rays(200)
    gaussians.sh[7] = torch.nan
    drawn = tracer.trace(tracer.take(gaussians), tracer.take(origins), tracer.take(directions)).color
    expected = ORACLE.trace(ORACLE.take(gaussians), ORACLE.take(origins), ORACLE.take(directions)).color
    assert expected.isnan().any()
    assert drawn.isnan().cpu()[expected.isnan()].all()
