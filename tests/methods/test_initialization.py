"""Initialization against closed forms."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from envgs_bench.core import Scene
from envgs_bench.methods.envgs import environment_box
from envgs_bench.methods.gaussians.initialization import (
    Orientation,
    box_inside,
    initial_orientation,
    initial_tensors,
    neighbor_distance,
    quantile_box,
    random_points_in_grid,
    random_points_on_sphere,
)


def test_neighbor_distance_on_a_lattice():
    axis = torch.arange(5.0)
    points = torch.cartesian_prod(axis, axis, axis) * 0.25
    assert torch.equal(neighbor_distance(points, 1.0), torch.full((125,), 0.25))


def test_neighbor_distance_is_the_root_of_the_mean_square():
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 2]])
    assert neighbor_distance(points, 1.0)[0].item() == pytest.approx(3**0.5)


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_few_points(n):
    distances = neighbor_distance(torch.eye(3)[:n], 2.0)
    assert distances.shape == (n,)
    assert (distances > 0).all()


def test_coincident_points_still_have_an_extent():
    assert (neighbor_distance(torch.ones(10, 3), 2.0) > 0).all()


def test_quantile_box_of_uniform_points():
    n = 200_001
    axis = torch.linspace(0, 1, n)
    points = torch.stack([axis, 2 * axis.flip(0) - 1, 5 + 0 * axis], dim=1)
    low, high = quantile_box(points, 0.995)
    torch.testing.assert_close(low[:2], torch.tensor([0.0025, -0.995]))
    torch.testing.assert_close(high[:2], torch.tensor([0.9975, 0.995]))
    assert low[2] < 5 < high[2]  # a flat cloud still has a box with a volume


def test_quantile_box_leaves_outliers_out():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(10_000, 3, generator=generator)
    points[0], points[1] = 1e6, -1e6
    low, high = quantile_box(points, 0.995)
    assert low.min() >= 0
    assert high.max() <= 1


def test_the_box_inside_holds_the_points_that_are_central_on_all_axes():
    points = torch.tensor(np.random.default_rng(0).standard_t(1.5, (3_000, 3)), dtype=torch.float32)
    low, high = np.quantile(points.double(), [0.005, 0.995], axis=0)
    kept = np.array([p for p in points.double().numpy() if (p >= low).all() and (p <= high).all()])
    for corner, expected in zip(box_inside(points, 0.99), (kept.min(axis=0), kept.max(axis=0)), strict=True):
        np.testing.assert_allclose(corner, expected, rtol=1e-6)
    central = quantile_box(points, 0.995)
    assert (box_inside(points, 0.99)[1] - box_inside(points, 0.99)[0]).prod() < 0.5 * (central[1] - central[0]).prod()


def test_a_box_inside_which_no_point_lies_is_the_quantiles():
    points = torch.eye(3)
    assert torch.equal(torch.stack(box_inside(points, 0.5)), torch.stack(quantile_box(points, 0.5)))


def test_every_cell_of_the_grid_gets_its_points():
    low, high = torch.tensor([-1.0, 0.0, 2.0]), torch.tensor([1.0, 3.0, 10.0])
    points = random_points_in_grid(low, high, 4, 3, torch.Generator().manual_seed(0))
    cell = ((points - low) / (high - low) * 4).floor().long().clamp(0, 3)
    counts = torch.bincount(cell @ torch.tensor([16, 4, 1]), minlength=64)
    assert points.shape == (192, 3)
    assert torch.equal(counts, torch.full((64,), 3))


def test_points_on_a_sphere_lie_on_it_in_every_direction():
    center = torch.tensor([1.0, -2.0, 3.0])
    points = random_points_on_sphere(center, 4.0, 4000, torch.Generator().manual_seed(0))
    torch.testing.assert_close((points - center).norm(dim=1), torch.full((4000,), 4.0))
    # Uniform directions: each coordinate is uniform in [−4, 4] (Archimedes), its mean within four standard errors of 0.
    coordinates = (points - center) / 4
    assert coordinates.mean(0).abs().max() < 4 / (3 * 4000) ** 0.5
    assert abs(float((coordinates[:, 2].abs() < 0.5).float().mean()) - 0.5) < 4 * 0.5 / 4000**0.5
    assert random_points_on_sphere(center, 4.0, 0, torch.Generator()).shape == (0, 3)


def test_initial_orientations():
    """Points of the plane x = 0: their surface faces along x, the world's third axis is z, at random any way.

    Quaternions of numbers between 0 and 1 have E qᵢqⱼ near ¼ for i ≠ j, not 0: n_x = 2(xz + wy) is positive on average.
    """
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(2000, 3, generator=generator) * torch.tensor([0.0, 1, 1])
    faced = {}
    for orientation in get_args(Orientation):
        quaternions = initial_orientation(points, orientation, generator).double().numpy()
        faced[orientation] = torch.from_numpy(Rotation.from_quat(quaternions, scalar_first=True).as_matrix()[:, :, 2])
    torch.testing.assert_close(faced["surface"][:, 0].abs(), torch.ones(2000, dtype=torch.float64))
    assert (faced["world"] == torch.tensor([0.0, 0, 1])).all()
    assert faced["random"].mean(0).abs().max() < 4 / (3 * 2000) ** 0.5
    torch.testing.assert_close(faced["random"].square().mean(0), torch.full((3,), 1 / 3).double(), atol=0.03, rtol=0)
    assert (faced["positive"][:, 0] > 0).all()
    numbers = initial_orientation(points, "positive", generator)
    assert abs(float(numbers.mean()) - 0.5) < 4 * (1 / 12 / 8000) ** 0.5
    assert 0 <= numbers.min() < numbers.max() <= 1


@pytest.mark.parametrize("axes", [2, 3])
def test_initial_primitives(axes):
    points = torch.rand(20, 3)
    tensors = initial_tensors(
        points,
        torch.rand(20, 3),
        torch.rand(20, 4),
        axes=axes,
        sh_degree=1,
        opacity=0.1,
        beta=1e-3,
        radius=1.0,
        scale=0.5,
    )
    expected = 0.5 * neighbor_distance(points, 1.0)[:, None].repeat(1, axes)
    torch.testing.assert_close(tensors["log_scales"].exp(), expected)
    torch.testing.assert_close(tensors["opacity_logits"].sigmoid(), torch.full((20,), 0.1))
    torch.testing.assert_close(tensors["beta_logits"].sigmoid(), torch.full((20, 1), 1e-3))
    assert tensors["sh_rest"].shape == (20, 3, 3)


def test_the_environment_starts_in_the_quantile_box_unless_the_scene_is_bounded():
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0))
    unbounded = Scene("points", [], [], points, torch.rand(500, 3))
    bounded = replace(unbounded, bounds=7.0)
    for corner, expected in zip(environment_box(unbounded), quantile_box(points, 0.995), strict=True):
        assert torch.equal(corner, expected)
    for corner, expected in zip(environment_box(unbounded, "inside"), box_inside(points, 0.99), strict=True):
        assert torch.equal(corner, expected)
    low, high = environment_box(bounded, "inside")
    assert (low.tolist(), high.tolist()) == ([-7] * 3, [7] * 3)
