"""Protocols, and the traps between two papers' numbers."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio

from envgs_bench.metrics import PROTOCOLS, Protocol, get_protocol
from envgs_bench.metrics.psnr import psnr


@pytest.fixture(autouse=True)
def no_weights(monkeypatch):
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")


def pair(height=32, width=40, seed=0, noise=0.1):
    generator = torch.Generator().manual_seed(seed)
    target = (torch.rand(height, width, 3, generator=generator) * 255).round() / 255
    return target + noise * torch.randn(height, width, 3, generator=generator), target


def test_psnr_is_scikit_images():
    prediction, target = pair()
    expected = peak_signal_noise_ratio(target.double().numpy(), prediction.double().numpy(), data_range=1)
    assert psnr(prediction, target) == expected


def test_psnr_of_equal_images_is_finite():
    _, target = pair()
    assert psnr(target, target) == 100
    assert psnr(target + 1e-9, target.double()) == 100


def test_pooled_error_is_not_the_mean_psnr():
    """Two images at 20 and 28 dB: their mean is 24 dB, the PSNR of their pooled error 22.4 dB."""
    target = torch.full((2, 16, 16, 3), 0.5)
    prediction = target + torch.tensor([10**-1.0, 10**-1.4])[:, None, None, None]
    each = [psnr(a, b) for a, b in zip(prediction, target, strict=True)]
    assert each == pytest.approx([20, 28], abs=1e-3)
    pooled = psnr(prediction.flatten(0, 1), target.flatten(0, 1))
    assert pooled == pytest.approx(-10 * math.log10((10**-2.0 + 10**-2.8) / 2), abs=1e-3)
    assert sum(each) / 2 - pooled > 1.6


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), density=st.floats(0.01, 1), noise=st.floats(0.01, 0.5))
def test_compositing_on_white_adds_ten_log_of_the_fraction(seed, density, noise):
    prediction, target = pair(seed=seed, noise=noise)
    mask = torch.rand(target.shape[:2], generator=torch.Generator().manual_seed(seed)) < density
    mask[0, 0] = True
    composited = get_protocol("envgs").score(prediction, target, mask)
    inside = psnr(prediction, target, mask)
    assert composited["fraction"] == pytest.approx(float(mask.float().mean()))
    assert composited["psnr"] == pytest.approx(inside - 10 * math.log10(composited["fraction"]), abs=1e-6)


@pytest.mark.parametrize("name", ["strict", "inria"])
def test_rounding_is_what_a_png_keeps(name, tmp_path):
    prediction, target = pair()
    rounded = np.floor(prediction.clamp(0, 1).numpy() * 255 + 0.5).astype(np.uint8)
    Image.fromarray(rounded).save(tmp_path / "render.png")
    read = torch.from_numpy(np.array(Image.open(tmp_path / "render.png"))).float() / 255
    protocol = get_protocol(name)
    assert protocol.score(prediction, target) == protocol.score(read, target)


def test_truncation_leaves_bytes_alone_and_rounds_others_down():
    protocol = get_protocol("nerfbaselines")
    _, target = pair()
    assert protocol.score(target, target)["psnr"] == 100
    assert protocol.score((target + 0.9 / 255).clamp(max=1), target)["psnr"] == 100
    assert get_protocol("strict").score((target + 0.9 / 255).clamp(max=1), target)["psnr"] < 50


def test_all_256_bytes_survive_every_protocol():
    levels = torch.arange(256, dtype=torch.uint8).reshape(16, 16, 1).expand(16, 16, 3).float() / 255
    for protocol in PROTOCOLS.values():
        assert protocol.score(levels, levels)["psnr"] == 100


def test_float_renders_are_scored_as_rendered():
    """Overexposure costs PSNR under envgs; a clamping protocol does not see it."""
    target = torch.ones(16, 16, 3)
    assert get_protocol("envgs").score(target * 1.1, target)["psnr"] == pytest.approx(20, abs=1e-4)
    assert get_protocol("strict").score(target * 1.1, target)["psnr"] == 100


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_full_mask_scores_as_no_mask(name):
    prediction, target = pair()
    protocol = get_protocol(name)
    full = protocol.score(prediction, target)
    masked = protocol.score(prediction, target, torch.ones(target.shape[:2], dtype=torch.bool))
    assert masked == {**full, "fraction": 1.0}
    assert set(full) == set(protocol.metrics)


def test_normalized_masking_sees_only_the_region_and_white_dilutes_it():
    prediction, target = pair()
    mask = torch.zeros(target.shape[:2], dtype=torch.bool)
    mask[8:16, 8:24] = True
    elsewhere = torch.where(mask[..., None], prediction, 1 - prediction)
    strict = get_protocol("strict")
    assert strict.score(elsewhere, target, mask)["psnr"] == strict.score(prediction, target, mask)["psnr"]
    envgs = get_protocol("envgs")
    assert envgs.score(elsewhere, target, mask) == envgs.score(prediction, target, mask)
    assert envgs.score(prediction, target, mask)["flip"] < strict.score(prediction, target, mask)["flip"] / 3


def test_an_empty_mask_scores_none():
    prediction, target = pair()
    empty = torch.zeros(target.shape[:2], dtype=torch.bool)
    for protocol in PROTOCOLS.values():
        scores = protocol.score(prediction, target, empty)
        assert scores == {**dict.fromkeys(protocol.metrics), "fraction": 0.0}


def test_hash_is_of_every_choice_and_not_of_the_name():
    assert len({protocol.hash for protocol in PROTOCOLS.values()}) == len(PROTOCOLS)
    assert Protocol("renamed", "none", "zero", "[0, 1]", "white").hash == get_protocol().hash
    assert all(len(protocol.hash) == 8 for protocol in PROTOCOLS.values())
    # Records have these hashes: a new one starts new tables.
    assert {name: protocol.hash for name, protocol in PROTOCOLS.items()} == {
        "envgs": "b9bc53ab",
        "strict": "195d498b",
        "inria": "42b30e72",
        "nerfbaselines": "3bfdd67e",
        "color_corrected": "d5e48701",
        "dists": "aeab304f",
    }


def test_description_names_the_choices():
    assert "zero padding" in get_protocol("envgs").description
    assert "composited on white" in get_protocol("envgs").description
    assert "rounded to 8 bits" in get_protocol("strict").description


def test_unknown_protocol_lists_the_known():
    with pytest.raises(ValueError, match="unknown protocol 'paper', expected one of envgs, strict, inria, nerfb"):
        get_protocol("paper")


def test_a_prediction_that_carries_gradients_is_scored():
    prediction, target = pair()
    assert get_protocol().score(prediction.clone().requires_grad_(), target) == get_protocol().score(prediction, target)


def test_bad_images_are_named():
    prediction, target = pair()
    score = get_protocol().score
    with pytest.raises(TypeError, match=r"prediction is torch\.uint8.*divide bytes by 255"):
        score((target * 255).byte(), target)
    with pytest.raises(TypeError, match="target is ndarray"):
        score(prediction, target.numpy())
    with pytest.raises(ValueError, match="sizes must agree"):
        score(prediction[:-1], target)
    with pytest.raises(ValueError, match=r"prediction has shape \(8, 40, 3\), expected \[H, W, 3\] of at least 16×16"):
        score(prediction[:8], target[:8])
    with pytest.raises(ValueError, match=r"target spans \[0, 255\]"):
        score(prediction, target * 255)
    broken = prediction.clone()
    broken[0, 0, :2] = torch.nan
    with pytest.raises(ValueError, match="prediction has 2 values of 3840 that are not finite"):
        score(broken, target)


def test_bad_masks_are_named():
    prediction, target = pair()
    with pytest.raises(TypeError, match=r"mask is torch\.float32, expected torch\.bool"):
        get_protocol().score(prediction, target, torch.ones(32, 40))
    with pytest.raises(ValueError, match=r"mask has shape \(40, 32\), expected the image's \(32, 40\)"):
        get_protocol().score(prediction, target, torch.ones(40, 32, dtype=torch.bool))
