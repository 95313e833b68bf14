"""Filtered maps against what a GGX lobe leaves of spherical harmonics: one integral over an angle gives it."""

import math

import pytest
import torch
from torch import Tensor

from envgs_bench.methods.lighting.cubemap import layout_of, sample_cubemap, texel_directions
from envgs_bench.methods.lighting.prefiltered_cubemap import ROUGHNESSES, RoughMap, prefilter_of, rough_map

SIZE = 32
AXIS = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8]), dim=0)


def legendre(cosine: Tensor) -> Tensor:
    """The first and the second Legendre polynomial, [..., 2]: of the angle to an axis, eigenfunctions of any lobe."""
    return torch.stack([cosine, (3 * cosine.square() - 1) / 2], dim=-1)


def random_directions(count: int) -> Tensor:
    directions = torch.randn(count, 3, generator=torch.Generator().manual_seed(3))
    return torch.nn.functional.normalize(directions, dim=1)


@pytest.fixture(scope="module")
def light() -> RoughMap:
    directions = torch.nn.functional.normalize(texel_directions(SIZE), dim=-1)
    return rough_map(legendre(directions @ AXIS), prefilter_of(SIZE))


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_a_lobe_leaves_its_share_of_each_harmonic(light: RoughMap, roughness: float) -> None:
    angle = (torch.arange(20_000, dtype=torch.float64) + 0.5) / 20_000 * math.pi / 2  # of the light to the lobe's axis
    half = (angle / 2).cos()
    alpha = roughness**2
    density = angle.cos() * angle.sin() / (half.square() * (alpha**2 - 1) + 1).square()  # GGX at h, times r·l, times dl
    shares = (legendre(angle.cos()) * density[:, None]).sum(0) / density.sum()

    directions = random_directions(500)
    found = light.specular(directions, torch.full((500,), roughness))
    expected = legendre(directions @ AXIS) * shares.float()
    torch.testing.assert_close(found, expected, atol=0.04, rtol=0)  # the smallest level has 4 texels an edge
    assert (found - expected).abs().mean() < 0.012


def test_between_levels_the_lookup_is_linear_in_roughness(light: RoughMap) -> None:
    directions = random_directions(50)

    def at(roughness: float) -> Tensor:
        return light.specular(directions, torch.full((50,), roughness))

    torch.testing.assert_close(at(0.45), 0.25 * at(0.3) + 0.75 * at(0.5))
    torch.testing.assert_close(at(0.75), 0.5 * at(0.5) + 0.5 * at(1.0))
    torch.testing.assert_close(at(0.0), at(0.08))


def test_a_smooth_surface_sees_the_map_itself(light: RoughMap) -> None:
    directions = random_directions(50)
    found = light.specular(directions, torch.zeros(50))
    torch.testing.assert_close(found, sample_cubemap(light.levels[0], directions, layout_of(SIZE)))


def test_one_color_stays_that_color() -> None:
    plain = rough_map(torch.full((6, 16, 16, 3), 0.7), prefilter_of(16))
    directions = random_directions(100)
    for roughness in (0.05, 0.3, 0.6, 1.0):
        found = plain.specular(directions, torch.full((100,), roughness))
        torch.testing.assert_close(found, torch.full((100, 3), 0.7))
    torch.testing.assert_close(plain.irradiance(directions), torch.full((100, 3), 0.7))


def test_the_irradiance_is_the_cosines_share(light: RoughMap) -> None:
    directions = random_directions(100)
    expected = legendre(directions @ AXIS) * torch.tensor([2 / 3, 1 / 4])  # Ramamoorthi and Hanrahan 2001
    torch.testing.assert_close(light.irradiance(directions), expected, atol=1e-3, rtol=0)


def test_gradients_reach_texels_directions_and_roughness() -> None:
    generator = torch.Generator().manual_seed(1)
    texels = torch.rand(6, 4, 4, 1, generator=generator, dtype=torch.float64, requires_grad=True)
    directions = random_directions(5).double().requires_grad_()
    roughness = torch.tensor([0.15, 0.35, 0.45, 0.7, 0.9], dtype=torch.float64, requires_grad=True)

    def color(*inputs: Tensor) -> Tensor:
        light = rough_map(inputs[0], prefilter_of(4))
        return torch.cat([light.specular(*inputs[1:]), light.irradiance(inputs[1])])

    assert torch.autograd.gradcheck(color, (texels, directions, roughness), atol=1e-6)
