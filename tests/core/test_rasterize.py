"""rasterize: single primitives and layers against closed forms, and its image's bookkeeping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from core_scenes import colored, facing_surfels, plain_camera, random_set, tilted_camera
from scipy.spatial.transform import Rotation

from envgs_bench.core import GaussianSet, rasterize_color

QUATERNION = torch.tensor([0.9, 0.2, -0.3, 0.15]) * 2.5


def single(columns: int, mean: list[float], scales: list[float], opacity: float = 0.8) -> GaussianSet:
    return GaussianSet(
        means=torch.tensor([mean]),
        quaternions=QUATERNION[None],
        scales=torch.tensor([scales[:columns]]),
        opacities=torch.tensor([opacity]),
        sh=colored(torch.tensor([[0.2, 0.5, 0.9]])),
        extras=torch.tensor([[0.3, 0.7]]),
    )


def expected_surfel(gaussians: GaussianSet, camera, low_pass: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """alpha, depth [H, W] and normal [3] of a single surfel, by solving o + t·d = p + u·s_u·t_u + v·s_v·t_v."""
    origins, directions = (rays.double().numpy() for rays in camera.rays())
    rotation = Rotation.from_quat(gaussians.quaternions[0].double().numpy(), scalar_first=True).as_matrix()
    mean, (su, sv) = gaussians.means[0].double().numpy(), gaussians.scales[0].double().tolist()
    pixels, depth = camera.project(gaussians.means[0])
    alphas, depths = np.zeros(directions.shape[:2]), np.zeros(directions.shape[:2])
    for row, column in np.ndindex(*alphas.shape):
        basis = np.stack([directions[row, column], -su * rotation[:, 0], -sv * rotation[:, 1]], axis=1)
        t, u, v = np.linalg.solve(basis, mean - origins[row, column])
        rho = u * u + v * v if t >= 0.2 else np.inf
        offset = np.array([column + 0.5, row + 0.5]) - pixels.double().numpy()
        if low_pass and 2 * offset @ offset < rho:
            rho, t = 2 * offset @ offset, float(depth)
        opacity = float(gaussians.opacities[0])
        if rho <= min(9, 2 * np.log(255 * opacity)):
            alphas[row, column] = min(0.99, opacity * np.exp(-rho / 2))
            depths[row, column] = t
    normal = rotation[:, 2] * (-1 if directions[5, 5] @ rotation[:, 2] > 0 else 1)
    return alphas, depths, normal


@pytest.mark.parametrize("low_pass", [True, False])
@pytest.mark.parametrize("opacity", [0.8, 0.02, 1.0])
@pytest.mark.parametrize("scales", [[0.25, 0.12], [0.01, 0.02]])
def test_a_surfel_is_where_its_plane_is_crossed(rasterizer, low_pass, opacity, scales):
    gaussians, camera = single(2, [0.4, 0.1, 2.5], scales, opacity), tilted_camera()
    alphas, depths, normal = expected_surfel(gaussians, camera, low_pass)
    background = torch.tensor([0.1, 0.6, 0.4])

    drawn = rasterizer.rasterize(
        rasterizer.take(gaussians), rasterizer.take(camera), low_pass=low_pass, background=background
    )

    as_numpy = {n: getattr(drawn, n).detach().double().cpu().numpy() for n in ("color", "alpha", "depth", "normal")}
    np.testing.assert_allclose(as_numpy["alpha"], alphas, atol=3e-5)
    np.testing.assert_allclose(as_numpy["depth"], depths, atol=3e-5)
    np.testing.assert_allclose(as_numpy["normal"], alphas[..., None] * normal, atol=3e-5)
    colors = alphas[..., None] * [0.2, 0.5, 0.9] + (1 - alphas[..., None]) * [0.1, 0.6, 0.4]
    np.testing.assert_allclose(as_numpy["color"], colors, atol=3e-5)
    np.testing.assert_allclose(drawn.extras.detach().cpu(), alphas[..., None] * [0.3, 0.7], atol=3e-5)
    np.testing.assert_array_equal(drawn.hits.cpu(), alphas > 0)
    assert drawn.hits.dtype == torch.int32
    assert drawn.statistics.weights.sum().item() == pytest.approx(alphas.sum(), rel=1e-4)
    assert (alphas > 0).any() == (low_pass or scales[0] > 0.1)


@pytest.mark.parametrize("low_pass", [True, False])
@pytest.mark.parametrize("mean", [[0.4, 0.1, 2.5], [1.4, -0.7, 1.8]], ids=["inside", "at-border"])
def test_a_3d_gaussian_is_projected_with_the_derivative_of_the_projection(rasterizer, low_pass, mean):
    gaussians, camera = single(3, mean, [0.25, 0.12, 0.06]), tilted_camera()
    exact = replace(camera, world_to_camera=camera.world_to_camera.double(), intrinsics=camera.intrinsics.double())
    point = gaussians.means[0].double()
    jacobian = torch.func.jacrev(lambda p: exact.project(p)[0])(point).numpy()
    rotation = Rotation.from_quat(QUATERNION.double().numpy(), scalar_first=True).as_matrix()
    covariance = rotation @ np.diag(gaussians.scales[0].double().numpy() ** 2) @ rotation.T
    on_screen = jacobian @ covariance @ jacobian.T + (0.3 * np.eye(2) if low_pass else 0)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    offsets = np.stack([columns, rows], -1) - exact.project(point)[0].numpy()
    rho = np.einsum("hwi,ij,hwj->hw", offsets, np.linalg.inv(on_screen), offsets)
    alphas = np.where(rho <= 9, 0.8 * np.exp(-rho / 2), 0)

    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(camera), low_pass=low_pass)

    normal = rotation[:, 2] * (-1 if (point.numpy() - camera.center.double().numpy()) @ rotation[:, 2] > 0 else 1)
    depth = exact.project(point)[1].item()
    np.testing.assert_allclose(drawn.alpha.detach().cpu(), alphas, atol=5e-5)
    np.testing.assert_allclose(drawn.normal.detach().cpu(), alphas[..., None] * normal, atol=5e-5)
    np.testing.assert_allclose(drawn.depth.detach().cpu(), np.where(alphas > 0, depth, 0), atol=5e-5)
    assert (alphas > 0).sum() > 20


def test_a_3d_gaussian_far_outside_the_image_is_linearized_at_its_margin(rasterizer):
    """A center at 80° from the axis, one σ of it inside: J is taken where x/z is (W − cx + 0.15·W)/fx."""
    camera = plain_camera(32, 32, focal=40.0)
    gaussians = replace(
        single(3, [3.0, 0.1, 0.53], [1.0, 1.0, 1.0]), quaternions=torch.tensor([[1.0, 0, 0, 0]]), means=torch.tensor(
            [[3.0, 0.1, 0.53]])
    )  # fmt: skip
    x, y, z = gaussians.means[0].double().tolist()
    held = (16 + 0.15 * 32) / 40
    jacobian = np.array([[40 / z, 0, -40 * held / z], [0, 40 / z, -40 * (y / z) / z]])
    on_screen = jacobian @ jacobian.T + 0.3 * np.eye(2)
    rows, columns = np.mgrid[:32, :32] + 0.5
    offsets = np.stack([columns - 16 - 40 * x / z, rows - 16 - 40 * y / z], -1)
    rho = np.einsum("hwi,ij,hwj->hw", offsets, np.linalg.inv(on_screen), offsets)
    expected = np.where(rho <= 9, 0.8 * np.exp(-rho / 2), 0)

    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(camera))

    assert (expected > 0).any()
    np.testing.assert_allclose(drawn.alpha.detach().cpu(), expected, atol=5e-5)


def test_a_3d_gaussian_shows_the_first_of_its_equally_short_axes(rasterizer):
    gaussians = single(3, [0.0, 0.0, 3.0], [0.2, 0.1, 0.1])
    rotation = Rotation.from_quat(QUATERNION.double().numpy(), scalar_first=True).as_matrix()
    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(plain_camera()))
    normal = drawn.normal[16, 16].detach().double().cpu().numpy()
    np.testing.assert_allclose(np.cross(normal, rotation[:, 1]), 0, atol=1e-6)
    assert normal[2] < 0


@pytest.mark.parametrize("columns", [2, 3])
def test_layers_blend_front_to_back_whatever_their_storage_order(rasterizer, columns):
    depths = torch.tensor([4.0, 2.0, 3.0])
    alphas, colors = [0.5, 0.6, 0.7], torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    gaussians = replace(
        facing_surfels(torch.stack([torch.zeros(3), torch.zeros(3), depths], 1)),
        opacities=torch.tensor(alphas),
        scales=torch.full((3, columns), 0.5),
        sh=colored(colors),
    )
    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(plain_camera()), background=torch.ones(3))

    weights = [0.4 * 0.3 * 0.5, 0.6, 0.4 * 0.7]
    left = 1 - sum(weights)
    expected = torch.tensor([weights[0] + left, weights[1] + left, weights[2] + left])
    torch.testing.assert_close(drawn.color[16, 16].detach().cpu().float(), expected, atol=1e-5, rtol=0)
    depth = (np.array(weights) * depths.numpy()).sum() / sum(weights)
    assert drawn.depth[16, 16].item() == pytest.approx(depth, abs=1e-5)
    assert drawn.alpha[16, 16].item() == pytest.approx(sum(weights), abs=1e-6)


@pytest.mark.parametrize("columns", [2, 3])
def test_equal_depths_blend_in_the_order_of_storage(rasterizer, columns):
    means = torch.tensor([[0.0, 0.0, 3.0]]).expand(5, 3)
    colors = torch.eye(5)[:, :3]
    gaussians = replace(
        facing_surfels(means), sh=colored(colors), scales=torch.full((5, columns), 0.5), extras=torch.eye(5)
    )
    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(plain_camera()))
    expected = torch.tensor([0.5, 0.25, 0.125, 0.0625, 0.03125])
    torch.testing.assert_close(drawn.extras[16, 16].detach().cpu().float(), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 1), (1, 65), (33, 47)])
def test_images_of_any_size(rasterizer, columns, size):
    camera = tilted_camera(*size)
    drawn = rasterizer.rasterize(rasterizer.take(random_set(40, columns=columns)), rasterizer.take(camera))
    width, height = size
    assert drawn.color.shape == drawn.normal.shape == (height, width, 3)
    assert drawn.alpha.shape == drawn.depth.shape == drawn.hits.shape == (height, width)
    assert drawn.extras.shape == (height, width, 1)
    assert (drawn.alpha > 0).any()


@pytest.mark.parametrize("columns", [2, 3])
def test_an_empty_set_is_background(rasterizer, columns):
    background = torch.tensor([0.2, 0.4, 0.8])
    gaussians = rasterizer.take(random_set(0, columns=columns, extras=2))
    drawn = rasterizer.rasterize(gaussians, rasterizer.take(plain_camera(5, 4)), background=background)
    torch.testing.assert_close(drawn.color.detach().cpu().float(), background.expand(4, 5, 3))
    for name in ("alpha", "depth", "normal", "extras", "hits"):
        assert not getattr(drawn, name).any()
    assert drawn.extras.shape == (4, 5, 2)
    assert drawn.statistics.weights.shape == (0,)


@pytest.mark.parametrize("columns", [2, 3])
def test_color_alone_of_an_empty_set_is_background(rasterizer, columns):
    background = torch.tensor([0.2, 0.4, 0.8])
    gaussians = rasterizer.take(random_set(0, columns=columns, extras=2))
    color, alpha = rasterizer.rasterize_color(gaussians, rasterizer.take(plain_camera(5, 4)), background=background)
    torch.testing.assert_close(color.cpu().float(), background.expand(4, 5, 3))
    assert alpha.shape == (4, 5)
    assert not alpha.any()


@pytest.mark.parametrize("columns", [2, 3])
def test_color_alone_refuses_gradients(rasterizer, columns):
    gaussians, camera = rasterizer.take(random_set(9, columns=columns)), rasterizer.take(plain_camera(5, 4))
    with pytest.raises(ValueError, match=r"rasterize_color has no gradients: call it within torch.no_grad\(\)"):
        rasterize_color(gaussians, camera, backend=rasterizer.name)
    color, _ = rasterize_color(gaussians.map(torch.Tensor.detach), camera, backend=rasterizer.name)
    assert not color.requires_grad


@pytest.mark.parametrize("columns", [2, 3])
def test_a_pixel_ends_with_the_hit_that_takes_it_below_the_threshold(rasterizer, columns):
    means = torch.stack([torch.zeros(6), torch.zeros(6), torch.arange(6) + 2.0], 1)
    gaussians = replace(facing_surfels(means, opacity=0.9), scales=torch.full((6, columns), 0.5))
    gaussians, camera = rasterizer.take(gaussians), rasterizer.take(plain_camera())
    drawn = rasterizer.rasterize(gaussians, camera, transmittance_min=5e-3)
    assert drawn.hits[16, 16].item() == 3
    assert drawn.alpha[16, 16].item() == pytest.approx(0.999, abs=1e-5)
    assert rasterizer.rasterize(gaussians, camera, transmittance_min=0.0).hits[16, 16].item() == 6


@pytest.mark.parametrize("columns", [2, 3])
def test_nothing_nearer_than_the_near_plane_is_drawn(rasterizer, columns):
    gaussians = rasterizer.take(single(columns, [0.0, 0.0, 2.0], [0.05, 0.05, 0.05]))
    camera = rasterizer.take(plain_camera())
    assert rasterizer.rasterize(gaussians, camera, near=1.7).alpha.max() > 0.5
    assert not rasterizer.rasterize(gaussians, camera, near=2.3).alpha.any()
