"""Spherical harmonics and rotations, against scipy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from core_scenes import facing_surfels, random_set, tilted_camera
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.core.torch.sh import sh_basis, sh_color


def real_harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """The real combinations of scipy's complex harmonics, in the order and with the signs of 3DGS's files."""
    x, y, z = directions.T
    polar, azimuth = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)
    columns = []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            value = sph_harm_y(l, abs(m), polar, azimuth)
            columns.append(value.real if m == 0 else math.sqrt(2) * (value.real if m > 0 else value.imag))
    return np.stack(columns, axis=-1)


def unit_vectors(count: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_is_scipys(degree):
    directions = unit_vectors(40)
    basis = sh_basis(torch.from_numpy(directions), degree)
    np.testing.assert_allclose(basis.numpy(), real_harmonics(directions, degree), atol=1e-12)


def test_basis_is_orthonormal_on_the_sphere():
    polar, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * (2 * np.pi / 16)
    z, phi = np.meshgrid(polar, azimuth, indexing="ij")
    r = np.sqrt(1 - z**2)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1).reshape(-1, 3)
    area = np.repeat(weights, 16) * (2 * np.pi / 16)
    basis = sh_basis(torch.from_numpy(directions), 3).numpy()
    np.testing.assert_allclose(basis.T @ (basis * area[:, None]), np.eye(16), atol=1e-12)


def test_color_ignores_the_length_of_the_offset_and_is_never_negative():
    directions = torch.from_numpy(unit_vectors(20))
    sh = torch.randn(20, 16, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    color = sh_color(sh, directions)
    torch.testing.assert_close(sh_color(sh, 7 * directions), color)
    assert (color == 0).any()
    assert (color >= 0).all()


def test_an_offset_of_zero_gives_a_finite_color_and_no_gradient():
    offset = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    color = sh_color(torch.full((1, 16, 3), 0.1, dtype=torch.float64), offset)
    color.sum().backward()
    assert color.isfinite().all()
    assert offset.grad is not None
    assert not offset.grad.any()


def test_rotations_are_scipys():
    quaternions = torch.randn(30, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 3
    expected = Rotation.from_quat(quaternions.numpy(), scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation_matrices(quaternions).numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("coefficient", range(16))
def test_traced_colors_are_scipys(tracer, coefficient):
    """One surfel after another, each on a ray of its own, seen from all around: color = Y·c + ½."""
    directions = torch.from_numpy(unit_vectors(12, seed=coefficient)).float()
    origin = torch.tensor([0.3, -0.2, 0.5])
    sh = torch.zeros(12, 16, 3)
    sh[:, coefficient] = torch.tensor([0.3, -0.2, 0.1])
    gaussians = replace(random_set(12, extras=0), means=origin + 2 * directions, sh=sh, opacities=torch.ones(12))
    gaussians = replace(gaussians, scales=torch.full((12, 2), 0.01))

    drawn = tracer.trace(*(tracer.take(x) for x in (gaussians, origin.expand(12, 3), directions)))

    expected = real_harmonics(directions.double().numpy(), 3)[:, coefficient, None] * [0.3, -0.2, 0.1] + 0.5
    assert (drawn.hits == 1).all()
    colors = (drawn.color / drawn.alpha[:, None]).detach().double().cpu().numpy()
    np.testing.assert_allclose(colors, expected, atol=2e-5)


@pytest.mark.parametrize("coefficient", range(16))
def test_colors_along_the_ray_are_scipys(tracer, coefficient):
    """Twelve rays of any length through one wide surfel, which they meet off its center."""
    away = torch.from_numpy(unit_vectors(12, seed=coefficient)).float()
    directions = away * torch.linspace(0.3, 2, 12)[:, None]
    sh = torch.zeros(1, 16, 3)
    sh[:, coefficient] = torch.tensor([0.3, -0.2, 0.1])
    surfel = replace(facing_surfels(torch.tensor([[0.2, -0.3, 0.0]]), scale=10.0, opacity=0.9), sh=sh)

    drawn = tracer.trace(*(tracer.take(x) for x in (surfel, -2 * away, directions)), sh_direction="ray")

    expected = real_harmonics(away.double().numpy(), 3)[:, coefficient, None] * [0.3, -0.2, 0.1] + 0.5
    assert (drawn.hits == 1).all()
    colors = (drawn.color / drawn.alpha[:, None]).detach().double().cpu().numpy()
    np.testing.assert_allclose(colors, expected, atol=2e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_rasterized_colors_are_scipys(rasterizer, degree):
    """The middle pixel's ray hits the only surfel at its center."""
    camera = tilted_camera(9, 9)
    origins, directions = camera.rays()
    mean = origins[4, 4] + 3 * directions[4, 4]
    sh = 0.3 * torch.randn(1, (degree + 1) ** 2, 3, generator=torch.Generator().manual_seed(degree))
    gaussians = replace(facing_surfels(mean[None], opacity=0.9), sh=sh)

    drawn = rasterizer.rasterize(rasterizer.take(gaussians), rasterizer.take(camera))

    offset = (mean - camera.center).double().numpy()
    basis = real_harmonics(offset[None] / np.linalg.norm(offset), degree)
    expected = np.maximum(0, basis @ sh[0].double().numpy() + 0.5)[0]
    color = (drawn.color / drawn.alpha[..., None])[4, 4].detach().double().cpu().numpy()
    np.testing.assert_allclose(color, expected, atol=2e-5)
