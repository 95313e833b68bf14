"""DISTS against torchmetrics' network, which is the authors' code, with the same VGG-16."""

from __future__ import annotations

import types

import numpy as np
import pytest
import torch
from torch import Tensor

from envgs_bench.metrics import WeightsUnavailable, get_protocol, vgg16
from envgs_bench.metrics.dists import CHANNELS, dists, l2_pooled, load_shares
from envgs_bench.metrics.vgg16 import Vgg16


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> Vgg16:
    """VGG-16 of random numbers: what is compared is what is made of its features."""
    torch.manual_seed(0)
    made = Vgg16().requires_grad_(False).eval()
    made.source = "random"
    monkeypatch.setattr(vgg16, "_loaded", lambda: made)
    return made


def pictures(height: int = 48, width: int = 60) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(1)
    target = torch.rand(height, width, 3, generator=random)
    return (target + 0.2 * torch.randn(height, width, 3, generator=random)).clamp(0, 1), target


def test_it_is_the_authors_distance(network: Vgg16, monkeypatch: pytest.MonkeyPatch) -> None:
    from torchmetrics.functional.image import dists as theirs

    weights = types.SimpleNamespace(DEFAULT=None)
    for name, value in {
        "_TORCHVISION_AVAILABLE": True,
        "VGG16_Weights": weights,
        "vgg16": lambda weights: network,
    }.items():
        monkeypatch.setattr(theirs, name, value, raising=False)
    prediction, target = pictures()
    batch = [image.permute(2, 0, 1)[None] for image in (prediction, target)]
    with torch.no_grad():
        expected = float(theirs.DISTSNetwork()(*batch))
    assert dists(prediction, target) == pytest.approx(expected, abs=1e-5)


def test_equal_pictures_have_none(network: Vgg16) -> None:
    _, target = pictures()
    assert dists(target, target) == pytest.approx(0, abs=1e-6)


def test_shares_are_those_of_all_channels_and_sum_to_one() -> None:
    alpha, beta = load_shares()
    assert tuple(map(len, alpha)) == tuple(map(len, beta)) == CHANNELS
    assert float(sum(part.sum() for part in (*alpha, *beta))) == pytest.approx(1)


def test_pooling_of_a_constant_is_the_constant_inside() -> None:
    pooled = l2_pooled(torch.full((1, 2, 8, 8), -3.0))
    assert pooled.shape == (1, 2, 4, 4)
    assert np.allclose(pooled[..., 1:, 1:], 3)


def test_only_its_protocol_takes_it(network: Vgg16) -> None:
    prediction, target = pictures()
    assert "dists" not in get_protocol().metrics
    scores = get_protocol("dists").score(prediction, target)
    assert scores["dists"] == pytest.approx(dists(prediction, target))
    assert scores["psnr"] == get_protocol().score(prediction, target)["psnr"]
    assert get_protocol("dists").hash != get_protocol().hash
    assert "DISTS" in get_protocol("dists").description


def test_without_weights_it_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    assert "switched off" in get_protocol("dists").not_computed["dists"]
    with pytest.raises(WeightsUnavailable):
        dists(*pictures())
