"""Losses on images where their value is known."""

import math

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch.nn import functional

from envgs_bench.core import Rendering, Statistics
from envgs_bench.core.ssim import ssim
from envgs_bench.methods.settings import GaussianSettings
from envgs_bench.methods.training.losses import (
    TrainingLoss,
    eroded,
    nearness,
    normal_distance,
    normal_loss,
    photometric_loss,
    training_psnr,
)
from envgs_bench.methods.training.schedule import Schedule
from envgs_bench.testing import tiny_scene


def test_normal_loss_is_one_minus_cosine_and_spares_unknown_pixels():
    angle = math.radians(60)
    reference = torch.zeros(2, 2, 3)
    reference[0, :, 2] = -1
    normal = torch.tensor([0.0, math.sin(angle), -math.cos(angle)]).expand(2, 2, 3)
    assert normal_loss(normal, reference).item() == pytest.approx(0.5 * (1 - math.cos(angle)))
    weight = torch.tensor([[1.0, 0.0], [1.0, 1.0]])
    assert normal_loss(normal, reference, weight).item() == pytest.approx(0.25 * (1 - math.cos(angle)))


def test_normal_distance_grows_with_the_angle_from_the_start():
    """|n − N|₁ of a normal turned by θ in the xz-plane is sin θ + 1 − cos θ: its slope at 0 is 1, that of 1 − cos 0."""
    angle = torch.tensor(0.02, dtype=torch.float64, requires_grad=True)
    reference = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(2, 2, 3).clone()
    reference[0, 0] = 0  # unknown
    turned = torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()]).expand(2, 2, 3)
    loss = normal_distance(turned, reference)
    torch.testing.assert_close(loss, 0.75 * (angle.sin() + 1 - angle.cos()))
    (slope,) = torch.autograd.grad(loss, angle)
    torch.testing.assert_close(slope, 0.75 * (angle.cos() + angle.sin()))


def test_photometric_loss_is_the_stated_mixture():
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(20, 30, 3, generator=generator), torch.rand(20, 30, 3, generator=generator)
    expected = 0.8 * (image - target).abs().mean() + 0.2 * (1 - ssim(image, target))
    torch.testing.assert_close(photometric_loss(image, target), expected)
    assert photometric_loss(target, target).item() == pytest.approx(0, abs=1e-6)


def test_losses_of_a_photograph_are_summed_to_float32s_precision():
    generator = torch.Generator().manual_seed(0)
    image, target = (torch.rand(3, 240_000, generator=generator).T.view(400, 600, 3) for _ in range(2))  # as drawn
    expected = (image.double() - target.double()).abs().mean().item()
    assert photometric_loss(image, target, 0.0).item() == pytest.approx(expected, rel=1e-6)
    unit, other = (functional.normalize(picture.double() - 0.5, dim=-1) for picture in (image, target))
    expected = (1 - (unit * other).sum(-1)).mean().item()
    assert normal_loss(unit.float(), other.float()).item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("prune_error", "step", "share"), [(0.05, 71, 0.35), (0.05, 70, 0.2), (0.0, 71, 0.2)])
def test_structure_counts_for_more_once_a_set_may_be_pruned(prune_error: float, step: int, share: float) -> None:
    """`prune_from` is 21,000 of 30,000 steps: step 70 of 100."""
    view = tiny_scene().train[0]
    target = view.rgb()
    image = torch.rand(target.shape, generator=torch.Generator().manual_seed(0))
    settings = GaussianSettings(prune_error=prune_error, normal_weight=0.0, mono_weight=0.0)
    flat = torch.zeros(target.shape[:2])
    drawn = Rendering(image, flat, flat, image, flat[..., None], flat.int(), Statistics(flat))
    terms = TrainingLoss(settings, Schedule(100)).terms(drawn, target, view, step, None, None)
    expected = (1 - share) * (image - target).abs().mean() + share * (1 - ssim(image, target))
    torch.testing.assert_close(terms, {"rgb": expected})


def test_nearness():
    depth = torch.tensor([[2.0, 6.0], [4.0, 0.0]])
    assert nearness(depth).tolist() == [[1.0, 0.0], [0.5, 1.0]]
    assert nearness(torch.full((2, 2), 3.0)).tolist() == [[1.0, 1.0], [1.0, 1.0]]
    assert nearness(torch.zeros(2, 2)).tolist() == [[1.0, 1.0], [1.0, 1.0]]


@pytest.mark.parametrize("shape", [(2, 3), (9, 7)])
def test_eroded_alpha_is_a_minimum_filter(shape: tuple[int, int]) -> None:
    alpha = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    expected = ndimage.minimum_filter(alpha.numpy(), size=4, mode="constant", cval=1.0)
    np.testing.assert_allclose(eroded(alpha).numpy(), expected, atol=1e-6)


def test_nearness_leaves_out_a_hundredth_at_either_end():
    """Between the third smallest and the third largest of 300 depths, as numpy sorts them."""
    depth = 2 + 3 * torch.rand(20, 15, generator=torch.Generator().manual_seed(0))
    depth[3, 4], depth[5, 6], depth[7, 8] = 0.3, 90.0, 70.0
    ordered = np.sort(depth.numpy().ravel())
    low, high = ordered[2], ordered[-3]
    assert high < 5
    expected = np.clip(1 - (depth.numpy() - low) / (high - low), 0, 1)
    np.testing.assert_allclose(nearness(depth).numpy(), expected, atol=1e-6)


def test_training_psnr():
    assert training_psnr(torch.full((4, 4, 3), 0.6), torch.full((4, 4, 3), 0.5)).item() == pytest.approx(20, abs=1e-3)
