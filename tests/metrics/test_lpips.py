"""LPIPS and VGG-16 against kornia's layers and torchmetrics' network, with random weights in torchvision's layout."""

import hashlib
import socket
import urllib.error

import pytest
import torch
from kornia.feature.dedode.vgg import cfgs, make_layers
from torchmetrics.functional.image import lpips as reference

from envgs_bench.metrics import get_protocol, make_perceptual_loss, vgg16
from envgs_bench.metrics.lpips import load_heads, lpips
from envgs_bench.metrics.vgg16 import WeightsUnavailable, find_weights, load_vgg16


@pytest.fixture(autouse=True)
def fresh_cache():
    """What one test loaded, or failed to load, is no other test's business."""
    vgg16._load.cache_clear()
    yield
    vgg16._load.cache_clear()


@pytest.fixture(scope="module")
def weights_file(tmp_path_factory):
    """Random VGG-16 weights under torchvision's names, and their hash."""
    torch.manual_seed(0)
    state = {f"features.{name}": value for name, value in make_layers(cfgs["D"]).state_dict().items()}
    state["classifier.0.bias"] = torch.zeros(3)  # the real file holds the classifier too
    path = tmp_path_factory.mktemp("weights") / "vgg16.pth"
    torch.save(state, path)
    return path, hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def random_weights(weights_file, monkeypatch):
    path, digest = weights_file
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(path))
    monkeypatch.setattr(vgg16, "WEIGHTS_SHA256", digest[:8])
    return path


@pytest.fixture
def kornias_layers(random_weights):
    with torch.device("meta"):
        layers = make_layers(cfgs["D"])
    state = torch.load(random_weights, weights_only=True)
    convolutions = {name.removeprefix("features."): value for name, value in state.items() if "features" in name}
    layers.load_state_dict(convolutions, assign=True)
    return layers


def images(height=40, width=50):
    return torch.rand(2, height, width, 3, generator=torch.Generator().manual_seed(1))


def test_features_are_those_of_kornias_vgg16(kornias_layers):
    batch = torch.randn(2, 3, 35, 50, generator=torch.Generator().manual_seed(2))
    found = load_vgg16()(batch)
    with torch.no_grad():
        expected = [kornias_layers[:end](batch) for end in (4, 9, 16, 23, 30)]  # after relu1_2 … relu5_3
    assert [tuple(features.shape[2:]) for features in found] == [(35, 50), (17, 25), (8, 12), (4, 6), (2, 3)]
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize(("input_range", "normalize"), [("[-1, 1]", True), ("[0, 1]", False)])
def test_lpips_is_torchmetrics(kornias_layers, monkeypatch, input_range, normalize):
    monkeypatch.setattr(reference, "_get_tv_model_features", lambda net, pretrained: kornias_layers)
    network = reference._LPIPS(net="vgg")
    prediction, target = images()
    first, second = (x.permute(2, 0, 1)[None] for x in (prediction, target))
    expected = float(network(first, second, normalize=normalize))
    assert expected > 1e-3
    assert lpips(prediction, target, input_range) == pytest.approx(expected, rel=1e-4)
    spatial = reference._LPIPS(net="vgg", spatial=True)(first, second, normalize=normalize)[0, 0]
    mask = torch.zeros(40, 50, dtype=torch.bool)
    mask[5:30, 20:47] = True
    assert lpips(prediction, target, input_range, mask) == pytest.approx(float(spatial[mask].mean()), rel=1e-4)


def test_lpips_is_zero_for_equal_images_and_enters_the_scores(random_weights):
    prediction, target = images()
    protocol = get_protocol("envgs")
    assert protocol.not_computed == {}
    assert protocol.score(target, target)["lpips"] == 0
    assert protocol.score(prediction, target)["lpips"] > 0


def test_heads_are_the_published_ones():
    heads = load_heads()
    assert [len(head) for head in heads] == [64, 128, 256, 512, 512]
    assert all((head >= 0).all() for head in heads)  # trained under that constraint


def test_perceptual_loss_is_l1_of_the_features_and_reaches_the_image(kornias_layers):
    image, target = images()
    loss = make_perceptual_loss()(image.requires_grad_(), target)
    mean, deviation = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
    with torch.no_grad():
        batch = ((torch.stack([image, target]) - mean) / deviation).permute(0, 3, 1, 2)
        expected = sum(
            float((features[0] - features[1]).abs().mean())
            for features in (kornias_layers[:end](batch) for end in (4, 9, 16, 23, 30))
        )
    assert loss.item() == pytest.approx(expected, rel=1e-5)
    loss.backward()
    assert image.grad is not None
    assert image.grad.abs().sum() > 0


def test_without_weights_lpips_is_none_with_a_reason(monkeypatch):
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    protocol = get_protocol()
    prediction, target = images()
    assert protocol.score(prediction, target)["lpips"] is None
    assert protocol.not_computed == {"lpips": "VGG-16 is switched off by ENVGS_BENCH_VGG16=off"}
    with pytest.raises(WeightsUnavailable):
        make_perceptual_loss()


def test_a_failed_download_is_tried_once_with_a_timeout_and_says_what_to_do(monkeypatch, tmp_path):
    attempts = []

    def no_network(url, path, hash_prefix):
        attempts.append((url, hash_prefix, socket.getdefaulttimeout()))
        raise urllib.error.URLError("no route to host")

    monkeypatch.delenv("ENVGS_BENCH_VGG16", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torch.hub, "download_url_to_file", no_network)
    for _ in range(2):
        with pytest.raises(WeightsUnavailable, match=r"could not be downloaded .*no route to host.*ENVGS_BENCH_VGG16"):
            load_vgg16()
    assert attempts == [("https://download.pytorch.org/models/vgg16-397923af.pth", "397923af", 5.0)]
    assert socket.getdefaulttimeout() is None
    with pytest.raises(WeightsUnavailable, match="not on this machine"):
        find_weights(download=False)
    assert len(attempts) == 1


def test_torch_hubs_cache_is_found(weights_file, monkeypatch, tmp_path):
    path, digest = weights_file
    cached = tmp_path / "checkpoints" / "vgg16-397923af.pth"
    cached.parent.mkdir()
    cached.symlink_to(path)
    monkeypatch.delenv("ENVGS_BENCH_VGG16", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(vgg16, "WEIGHTS_SHA256", digest[:8])
    assert find_weights(download=False) == cached


def test_a_missing_or_foreign_file_is_refused(monkeypatch, tmp_path):
    path = tmp_path / "vgg16.pth"
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(path))
    with pytest.raises(WeightsUnavailable, match=r"ENVGS_BENCH_VGG16 names .*vgg16\.pth, which is no file"):
        find_weights()
    path.write_bytes(b"truncated")
    with pytest.raises(WeightsUnavailable, match=r"is not torchvision's VGG-16.*expected 397923af"):
        find_weights()


def test_unknown_input_range_is_refused():
    with pytest.raises(ValueError, match=r"unknown input range 'bytes', expected one of \[0, 1\], \[-1, 1\]"):
        lpips(*images(), "bytes")
