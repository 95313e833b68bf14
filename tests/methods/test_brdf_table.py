"""The split-sum table against the BRDF integrated over the directions of light, which is not how it is made."""

import math

import pytest
import torch

from envgs_bench.methods.lighting.brdf_table import brdf_table, specular_weight


def reflected_share(cosine: float, roughness: float, reflectance: float) -> float:
    """∫ D·F·G / (4·(n·l)·(n·v))·(n·l) dl over the hemisphere of light directions l."""
    alpha, steps = roughness**2, 800
    middles = (torch.arange(steps, dtype=torch.float64) + 0.5) / steps
    elevation, azimuth = (middles * math.pi / 2)[:, None], (middles * 2 * math.pi)[None, :]
    light = torch.stack(
        torch.broadcast_tensors(elevation.sin() * azimuth.cos(), elevation.sin() * azimuth.sin(), elevation.cos()), -1
    )
    view = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64)
    half = torch.nn.functional.normalize(light + view, dim=-1)
    n_h, n_l, v_h = half[..., 2], light[..., 2], half @ view
    distribution = alpha**2 / (math.pi * (n_h.square() * (alpha**2 - 1) + 1).square())
    masking, shadowing = (((1 + alpha**2 * (1 / c**2 - 1)) ** 0.5 - 1) / 2 for c in (cosine, n_l))  # Smith's Λ
    geometry = 1 / (1 + masking + shadowing)
    fresnel = reflectance + (1 - reflectance) * (1 - v_h) ** 5
    integrand = distribution * geometry * fresnel / (4 * cosine) * elevation.sin()
    return float(integrand.mean()) * math.pi / 2 * 2 * math.pi


@pytest.mark.parametrize(("cosine", "roughness"), [(1.0, 1.0), (0.9, 0.4), (0.5, 0.5), (0.3, 0.7), (0.2, 1.0)])
@pytest.mark.parametrize("reflectance", [0.04, 0.9])
def test_a_surface_reflects_what_its_brdf_integrates_to(cosine: float, roughness: float, reflectance: float) -> None:
    found = specular_weight(torch.tensor([reflectance]), torch.tensor(cosine), torch.tensor(roughness))
    assert float(found) == pytest.approx(reflected_share(cosine, roughness, reflectance), abs=6e-3)


def test_a_polished_surface_follows_fresnel() -> None:
    cosine = torch.linspace(0.1, 1, 10)
    found = specular_weight(torch.full((10, 1), 0.04), cosine, torch.zeros(10))[:, 0]
    torch.testing.assert_close(found, 0.04 + 0.96 * (1 - cosine) ** 5, atol=6e-3, rtol=0)  # linear between nodes


def test_no_surface_reflects_more_than_it_receives() -> None:
    assert (brdf_table() >= 0).all()
    assert (brdf_table().sum(-1) <= 1.02).all()  # the approximate G gains up to 2 %, where it is rough and grazing


def test_the_lookup_is_differentiable_in_all() -> None:
    values = [torch.rand(6, *shape, dtype=torch.float64, requires_grad=True) for shape in ((3,), (), ())]
    assert torch.autograd.gradcheck(specular_weight, values, atol=1e-6)


def test_what_is_not_a_number_is_looked_up_without_an_error() -> None:
    """A step replayed from a graph that lacked room shows NaN: an index made of it would end a GPU's run."""
    spoiled, sound = torch.tensor([0.5, torch.nan, 0.5]), torch.full((3,), 0.5)
    for cosine, roughness in ((spoiled, sound), (sound, spoiled)):
        found = specular_weight(torch.full((3, 1), 0.04), cosine, roughness)[:, 0]
        assert found.isnan().tolist() == [False, True, False]
