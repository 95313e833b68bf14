"""Color-corrected scores: the map is NumPy's least-squares one, and exposure and tint cost nothing after it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from envgs_bench.metrics import get_protocol
from envgs_bench.metrics.color_correction import color_corrected


def pair() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(24, 32, 3, generator=generator)
    return (target + 0.1 * torch.randn(24, 32, 3, generator=generator)).clamp(0, 1), target


@pytest.mark.parametrize("of_one_color", [False, True])
def test_the_map_is_numpys(of_one_color: bool) -> None:
    """Of a picture of one color, too, which many maps bring as near."""
    prediction, target = pair()
    if of_one_color:
        prediction = torch.full_like(prediction, 0.3)
    colors, wanted = (image.double().numpy().reshape(-1, 3) for image in (prediction, target))
    with_one = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
    expected = with_one @ np.linalg.lstsq(with_one, wanted, rcond=None)[0]
    found = color_corrected(prediction, target).reshape(-1, 3).double().numpy()
    np.testing.assert_allclose(found, expected.clip(0, 1), atol=1e-6)


def test_an_affine_map_of_color_costs_nothing() -> None:
    """Of 0.8 times the light and a tint, plain scores suffer; a noise costs both."""
    noisy, target = pair()
    mixed = target @ torch.tensor([[0.7, 0.1, 0.0], [0.0, 0.8, 0.05], [0.1, 0.0, 0.6]]) + 0.05
    protocol = get_protocol("color_corrected")
    scores = protocol.score(mixed, target)
    assert scores["psnr"] < 20
    assert scores["cc_psnr"] == pytest.approx(100, abs=40)
    assert scores["cc_ssim"] == pytest.approx(1, abs=1e-5)
    assert get_protocol("color_corrected").score(noisy, target)["cc_psnr"] < 25


def test_plain_metrics_are_those_of_envgs_and_regions_take_the_whole_views_map() -> None:
    prediction, target = pair()
    mask = torch.zeros(target.shape[:2], dtype=torch.bool)
    mask[8:16, 8:24] = True
    protocol, plain = get_protocol("color_corrected"), get_protocol("envgs")
    corrected = plain.score(color_corrected(prediction, target), target, mask)
    expected = {f"cc_{name}": corrected[name] for name in ("psnr", "ssim", "lpips")}
    assert protocol.score(prediction, target, mask) == plain.score(prediction, target, mask) | expected
    assert protocol.hash != plain.hash
