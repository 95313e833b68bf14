"""FLIP against NVIDIA's evaluator, a stored figure, and the paper's formula for uniform images."""

import flip_evaluator
import numpy as np
import pytest
import torch

from envgs_bench.metrics.flip import flip, flip_map

LINEAR_TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)


def hunt_adjusted_lab(linear):
    relative = LINEAR_TO_XYZ @ linear / LINEAR_TO_XYZ.sum(axis=1)
    f = np.where(relative > (6 / 29) ** 3, np.cbrt(relative), relative / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * f[1] - 16
    return lightness, 0.01 * lightness * np.array([500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def color_difference(first, second):
    """HyAB^0.7 of two linear colors."""
    (l1, ab1), (l2, ab2) = hunt_adjusted_lab(np.array(first)), hunt_adjusted_lab(np.array(second))
    return (abs(l1 - l2) + np.linalg.norm(ab1 - ab2)) ** 0.7


def uniform_flip(first, second):
    """FLIP of two uniform sRGB images: no filter changes them and they have no features (Andersson et al., Sec. 4)."""

    def linear(srgb):
        srgb = np.array(srgb)
        return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)

    largest = color_difference([0, 1, 0], [0, 0, 1])
    difference, knee = color_difference(linear(first), linear(second)), 0.4 * largest
    if difference < knee:
        return 0.95 * difference / knee
    return 0.95 + 0.05 * (difference - knee) / (largest - knee)


def random_pair():
    generator = np.random.default_rng(0)
    return tuple(torch.from_numpy(generator.random((120, 160, 3), dtype=np.float32)) for _ in range(2))


@pytest.mark.parametrize(
    ("prediction", "target"),
    [([0, 0, 0], [1, 1, 1]), ([0.25, 0.35, 0.6], [0.2, 0.4, 0.6]), ([0, 1, 1], [1, 0, 0]), ([0.5, 0.5, 0.5],) * 2],
)
def test_uniform_images_follow_the_papers_formula(prediction, target):
    images = [torch.tensor(color, dtype=torch.float32).expand(24, 32, 3) for color in (prediction, target)]
    assert flip(*images) == pytest.approx(uniform_flip(prediction, target), abs=1e-4)


def smooth_pair():
    """A picture of waves with an edge, and one with noise on it."""
    generator = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(0, 9, 160), np.linspace(0, 7, 120))
    waves = 0.5 + 0.4 * np.sin(np.stack([x + y, 2 * x, y * y / 3], axis=-1)) * (x > 4)[..., None]
    noisy = (waves + generator.normal(0, 0.02, waves.shape)).clip(0, 1)
    return tuple(torch.from_numpy(image.astype(np.float32)) for image in (noisy, waves))


@pytest.mark.parametrize("pair", [random_pair, smooth_pair])
def test_map_is_the_evaluators_under_its_default_conditions(pair):
    prediction, target = pair()
    expected, mean, _ = flip_evaluator.evaluate(target.numpy(), prediction.numpy(), "LDR", applyMagma=False)
    np.testing.assert_allclose(flip_map(prediction, target), expected[..., 0], atol=2e-5)
    assert flip(prediction, target) == pytest.approx(mean, abs=2e-6)


def test_figure_is_the_stored_one():
    """flip-evaluator 1.7; another figure means that another definition came with an update."""
    assert flip(*random_pair()) == pytest.approx(0.44111, abs=1e-4)


def test_masked_mean_is_that_of_the_map():
    prediction, target = random_pair()
    mask = torch.zeros(120, 160, dtype=torch.bool)
    mask[10:50, 30:90] = True
    expected = flip_map(prediction, target)[10:50, 30:90].double().mean()
    assert flip(prediction, target, mask) == pytest.approx(float(expected))


def test_values_out_of_range_are_clamped():
    prediction, target = random_pair()
    overexposed = prediction * 3 - 1
    torch.testing.assert_close(flip_map(overexposed, target), flip_map(overexposed.clamp(0, 1), target))
