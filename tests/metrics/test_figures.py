"""Whole protocols on a photograph against figures that other programs gave for it, stored, so that neither can drift.

The pair is scikit-image's astronaut, and the same moved by one pixel with what leaves on the right coming in left.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import skimage.data
import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from envgs_bench.metrics import PROTOCOLS, get_protocol

PSNR = 23.786488183  # scikit-image 0.26.0, peak_signal_noise_ratio
SSIM_VALID = 0.830523102  # scikit-image 0.26.0, structural_similarity, Gaussian of σ 1.5; leaves the border out
SSIM_REFLECTED = 0.8272  # torchmetrics 1.9, which counts a border of reflected pixels: nobody's protocol here
FLIP = 0.111372  # NVIDIA's flip-evaluator 1.7, LDR


@pytest.fixture(autouse=True)
def no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")


@pytest.fixture(scope="module")
def photograph() -> np.ndarray:
    return skimage.data.astronaut()


def pair(photograph: np.ndarray) -> tuple[Tensor, Tensor]:
    moved = np.roll(photograph, 1, axis=1)
    return torch.from_numpy(moved).float() / 255, torch.from_numpy(photograph).float() / 255


def test_every_protocol_gives_the_stored_figures(photograph: np.ndarray) -> None:
    """8-bit pictures: all protocols have one PSNR, and two SSIMs between them, by what they do at the border."""
    for protocol in PROTOCOLS.values():
        scores = protocol.score(*pair(photograph))
        assert scores["psnr"] == pytest.approx(PSNR, abs=1e-5)
        assert scores["flip"] == pytest.approx(FLIP, abs=1e-5)
        if protocol.ssim_padding == "valid":
            assert scores["ssim"] == pytest.approx(SSIM_VALID, abs=1e-7)
        else:
            assert scores["ssim"] == pytest.approx(SSIM_VALID, abs=2e-3)
            assert abs(scores["ssim"] - SSIM_VALID) > 5e-4
            assert abs(scores["ssim"] - SSIM_REFLECTED) > 5e-4


def test_masked_figures_are_scikit_images_inside_the_mask(photograph: np.ndarray) -> None:
    prediction, target = pair(photograph)
    y, x = np.mgrid[:512, :512]
    mask = np.hypot(x - 200, y - 120) < 150  # reaches over the upper border
    moved = np.roll(photograph, 1, axis=1)
    _, similarity = structural_similarity(
        photograph,
        moved,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=255,
        full=True,
    )
    inner = np.zeros_like(mask)
    inner[5:-5, 5:-5] = mask[5:-5, 5:-5]
    error = ((photograph / 255 - moved / 255) ** 2)[mask].mean()
    strict = get_protocol("strict").score(prediction, target, torch.from_numpy(mask))
    assert strict["psnr"] == pytest.approx(-10 * math.log10(error), abs=1e-5)
    assert strict["ssim"] == pytest.approx(similarity[inner].mean(), abs=1e-7)
    on_white = get_protocol("envgs").score(prediction, target, torch.from_numpy(mask))
    assert on_white["psnr"] == pytest.approx(-10 * math.log10(error) - 10 * math.log10(mask.mean()), abs=1e-5)
    assert on_white["fraction"] == strict["fraction"] == pytest.approx(mask.mean())
