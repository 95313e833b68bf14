"""SSIM, the loss and the metric, against scikit-image, kornia, torchmetrics, scipy and automatic differentiation."""

import kornia.metrics
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import convolve
from skimage.metrics import structural_similarity
from torch.nn import functional
from torchmetrics.functional.image import structural_similarity_index_measure

from envgs_bench.core.ssim import TAPS, ssim, ssim_map
from envgs_bench.metrics.ssim import ssim as scored_ssim


def picture(height=40, width=53, seed=0):
    """A smooth picture and a blemished copy, [H, W, 3] float64: SSIM well inside (0, 1)."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / 9
    smooth = np.stack([np.sin(x) * np.cos(y), np.cos(x + y), np.sin(x - y)], axis=-1) * 0.4 + 0.5
    noisy = np.clip(smooth + generator.normal(0, 0.06, smooth.shape), 0, 1)
    return torch.from_numpy(noisy), torch.from_numpy(smooth)


def test_valid_map_is_scikit_images():
    image, target = picture()
    _, expected = structural_similarity(
        target.numpy(),
        image.numpy(),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1,
        channel_axis=-1,
        full=True,
    )
    np.testing.assert_allclose(ssim_map(image, target, "valid", backend="torch"), expected[5:-5, 5:-5], atol=1e-12)


def test_valid_map_is_torchmetrics_and_kornias():
    """torchmetrics averages a map that it padded by reflection: inside the image it is ours, its mean is not."""
    image, target = picture()
    first, second = (x.permute(2, 0, 1)[None] for x in (image, target))
    mean, padded = structural_similarity_index_measure(first, second, data_range=1.0, return_full_image=True)
    kornias = kornia.metrics.ssim(first, second, 11, eps=0.0, padding="valid")
    ours = ssim_map(image, target, "valid", backend="torch").permute(2, 0, 1)[None]
    torch.testing.assert_close(ours, padded[..., 5:-5, 5:-5], atol=1e-10, rtol=0)
    torch.testing.assert_close(ours, kornias, atol=1e-10, rtol=0)
    assert abs(float(mean) - float(ours.mean())) > 1e-3


def test_zero_padded_map_and_its_gradient_are_kornias_of_padded_images():
    """kornia pads by reflection alone: black is put around both images first."""
    image, target = picture()
    found, expected = (image.clone().requires_grad_() for _ in range(2))
    ours = ssim_map(found, target, backend="torch")
    first, second = (functional.pad(x.permute(2, 0, 1)[None], (5, 5, 5, 5)) for x in (expected, target))
    kornias = kornia.metrics.ssim(first, second, 11, eps=0.0, padding="valid")[0].permute(1, 2, 0)
    torch.testing.assert_close(ours, kornias, atol=1e-12, rtol=0)
    weights = torch.linspace(-1, 1, ours.numel(), dtype=torch.float64).reshape(ours.shape)
    for values in (ours, kornias):
        (values * weights).sum().backward()
    torch.testing.assert_close(found.grad, expected.grad, atol=1e-10, rtol=1e-10)


def test_zero_padded_map_is_the_formula_with_black_beyond_the_image():
    image, target = (x.numpy() for x in picture())
    window = np.exp(-(np.add.outer(np.arange(-5, 6) ** 2, np.arange(-5, 6) ** 2)) / (2 * 1.5**2))
    window = (window / window.sum())[..., None]

    def moment(values):
        return convolve(values, window, mode="constant")

    mean_x, mean_y = moment(image), moment(target)
    variance_x, variance_y = moment(image**2) - mean_x**2, moment(target**2) - mean_y**2
    covariance = moment(image * target) - mean_x * mean_y
    expected = ((2 * mean_x * mean_y + 1e-4) * (2 * covariance + 9e-4)) / (
        (mean_x**2 + mean_y**2 + 1e-4) * (variance_x + variance_y + 9e-4)
    )
    ours = ssim_map(torch.from_numpy(image), torch.from_numpy(target), backend="torch")
    np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_definitions_of_the_border_differ_beyond_the_third_decimal():
    """So a table may hold one of them only."""
    image, target = picture()
    first, second = (x.permute(2, 0, 1)[None] for x in (image, target))
    zero, valid = (float(ssim(image, target, padding, backend="torch")) for padding in ("zero", "valid"))
    reflected = float(torch.as_tensor(structural_similarity_index_measure(first, second, data_range=1.0)))
    assert min(abs(zero - valid), abs(zero - reflected), abs(valid - reflected)) > 1e-3


@pytest.mark.parametrize("padding", ["zero", "valid"])
def test_gradient_is_the_derivative(padding):
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(14, 12, 2, dtype=torch.float64, generator=generator).requires_grad_()
    target = torch.rand(14, 12, 2, dtype=torch.float64, generator=generator)
    assert torch.autograd.gradcheck(lambda x: ssim_map(x, target, padding, backend="torch"), (image,))


@settings(max_examples=25, deadline=None)
@given(height=st.integers(1, 24), width=st.integers(1, 24), seed=st.integers(0, 1000))
def test_any_size_is_symmetric_bounded_and_one_for_equal_images(height, width, seed):
    generator = torch.Generator().manual_seed(seed)
    a, b = torch.rand(2, height, width, 3, generator=generator, dtype=torch.float64)
    there, back = (ssim_map(*pair, backend="torch") for pair in ((a, b), (b, a)))
    torch.testing.assert_close(there, back)
    assert there.shape == a.shape
    assert there.abs().max() <= 1 + 1e-9
    assert float(ssim(a, a, backend="torch")) == pytest.approx(1.0, abs=1e-12)


def test_float32_is_close_enough_to_train_with():
    image, target = picture()
    assert float(ssim(image.float(), target.float())) == pytest.approx(
        float(ssim(image, target, backend="torch")), abs=1e-5
    )


def test_window_is_normalized_and_symmetric():
    assert sum(TAPS) == pytest.approx(1, abs=1e-15)
    assert TAPS[::-1] == TAPS


def test_masked_mean_counts_window_centers_inside_the_mask():
    image, target = picture()
    mask = torch.zeros(image.shape[:2], dtype=torch.bool)
    mask[2:20, 7:31] = True
    full = ssim_map(image, target, backend="torch")
    assert scored_ssim(image, target, "zero", mask) == pytest.approx(float(full[2:20, 7:31].mean()))
    assert scored_ssim(image, target, "valid", mask) == pytest.approx(float(full[5:20, 7:31].mean()))
    border = torch.zeros_like(mask)
    border[:4] = True
    assert scored_ssim(image, target, "valid", border) is None


def test_bad_input_is_named():
    image, target = picture()
    with pytest.raises(ValueError, match=r"share a shape \[H, W, C\]"):
        ssim_map(image, target[:-1])
    with pytest.raises(ValueError, match=r"target\.detach"):
        ssim_map(image, target.clone().requires_grad_())
    with pytest.raises(ValueError, match="unknown padding 'same', expected one of zero, valid"):
        ssim_map(image, target, "same")
    with pytest.raises(ValueError, match="at least 11×11 pixels"):
        ssim_map(image[:10], target[:10], "valid")
    with pytest.raises(ValueError, match=r"backend 'cpu' takes float32 tensors on cpu, got torch\.float64"):
        ssim_map(image, target)
