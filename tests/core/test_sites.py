"""Colors by sites: closed forms, finite differences of the oracle, and every backend against it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import Backend, facing_surfels, random_set
from torch import Tensor

from envgs_bench.core import GaussianSet
from envgs_bench.core.torch.colors import site_color


def sites(count: int, sharp: float = 3.0, seed: int = 0) -> Tensor:
    """[count, 8, 6] colors in ±0.7 and vectors of a length about `sharp`."""
    generator = torch.Generator().manual_seed(seed)
    colors = 1.4 * torch.rand(count, 8, 3, generator=generator) - 0.7
    return torch.cat([colors, sharp * torch.randn(count, 8, 3, generator=generator)], dim=-1).double()


def directions(count: int, seed: int = 1) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)), dim=1)


def test_sharp_sites_show_the_color_of_the_nearest() -> None:
    """As cells end more sharply the sphere becomes a Voronoi diagram of equally long vectors."""
    own, toward = sites(50, seed=2), directions(50).double()
    unit = torch.nn.functional.normalize(own[..., 3:], dim=-1)
    own = torch.cat([own[..., :3].abs(), 1e4 * unit], dim=-1)
    nearest = (unit - toward[:, None]).norm(dim=-1).argmin(-1)
    expected = own[torch.arange(50), nearest, :3]
    torch.testing.assert_close(site_color(own, toward), expected, atol=1e-6, rtol=0)


def test_sites_without_a_direction_show_their_mean_everywhere() -> None:
    own = torch.cat([sites(20)[..., :3].abs(), torch.zeros(20, 8, 3)], dim=-1)
    torch.testing.assert_close(site_color(own, directions(20).double()), own[..., :3].mean(1))


def test_colors_ignore_the_length_of_the_offset_and_are_never_negative() -> None:
    own, toward = sites(60), directions(60).double()
    color = site_color(own, toward)
    torch.testing.assert_close(site_color(own, 7 * toward), color)
    assert (color == 0).any()
    assert (color >= 0).all()


def test_gradients_of_the_oracle_are_differences() -> None:
    own = sites(6)
    own = torch.cat([own[..., :3] + 1, own[..., 3:]], dim=-1).requires_grad_()  # no color is cut at 0
    toward = (2 * directions(6).double()).requires_grad_()
    assert torch.autograd.gradcheck(site_color, (own, toward), eps=1e-6, atol=1e-7)


def test_an_offset_of_zero_has_the_mean_color_and_no_gradient() -> None:
    offset, own = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True), sites(1).abs()
    color = site_color(own, offset)
    color.sum().backward()
    torch.testing.assert_close(color, own[..., :3].mean(1))
    assert offset.grad is not None
    assert not offset.grad.any()


def test_a_traced_surfel_shows_what_its_sites_say(tracer: Backend) -> None:
    """One surfel after another, each on a ray of its own: the color by hand, and its gradient by the sites."""
    count = 40
    means = torch.tensor([0.0, 0.0, 3.0]) + torch.arange(count)[:, None] * torch.tensor([10.0, 0, 0])
    own, toward = sites(count), directions(count)
    toward[:, 2] = 0.3 + toward[:, 2].abs()
    surfels = replace(facing_surfels(means, scale=2.0, opacity=0.5), sh=own.float())
    own = surfels.sh.double()
    starts = means - toward
    leaves, origins, rays = (tracer.take(x) for x in (surfels, starts, toward))
    drawn = tracer.trace(leaves, origins, rays, t_min=0.0)
    by_hand = own.clone().requires_grad_()
    expected = 0.5 * site_color(by_hand, means.double() - starts.double())
    assert (drawn.color.double().cpu() - expected).abs().max() < tracer.tolerance
    drawn.color.sum().backward()
    expected.sum().backward()
    assert leaves.sh.grad is not None
    assert by_hand.grad is not None
    torch.testing.assert_close(leaves.sh.grad.double().cpu(), by_hand.grad, atol=20 * tracer.tolerance, rtol=1e-3)


def test_a_set_with_sites_says_that_it_has_no_sh_degree() -> None:
    surfels = replace(random_set(3), sh=sites(3).float())
    assert surfels.has_sites
    with pytest.raises(ValueError, match="no SH degree"):
        _ = surfels.sh_degree


def test_another_number_of_sites_is_refused() -> None:
    base = random_set(3)
    with pytest.raises(ValueError, match=r"GaussianSet\.sh has shape \(3, 7, 6\)"):
        GaussianSet(base.means, base.quaternions, base.scales, base.opacities, torch.zeros(3, 7, 6))
