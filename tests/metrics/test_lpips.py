"""LPIPS and VGG-16 against plain convolutions and torchmetrics' network; random weights in torchvision's layout."""

import hashlib

import pytest
import torch
from kornia.feature.dedode.vgg import cfgs, make_layers
from recordable import WaitsForTheDevice
from torch.nn import functional
from torchmetrics.functional.image import lpips as reference

from envgs_bench.metrics import WeightsUnavailable, get_protocol, make_perceptual_loss, vgg16, weights
from envgs_bench.metrics import lpips as lpips_module
from envgs_bench.metrics.lpips import load_heads, lpips
from envgs_bench.metrics.vgg16 import load_vgg16


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
    monkeypatch.setattr(weights, "TORCHVISION_SHA256", digest)
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


def test_features_are_those_of_the_plain_convolutions(random_weights):
    """Simonyan and Zisserman's configuration D, written out: rectified 3×3 convolutions, halved after five of them."""
    state = torch.load(random_weights, weights_only=True)
    batch = torch.randn(2, 3, 35, 50, generator=torch.Generator().manual_seed(2))
    found = load_vgg16()(batch)
    expected, images = [], batch
    for stage in ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)):
        images = functional.max_pool2d(images, 2) if expected else images
        for layer in stage:
            kernel, bias = (state[f"features.{layer}.{part}"] for part in ("weight", "bias"))
            images = functional.conv2d(images, kernel, bias, padding=1).clamp(min=0)
        expected.append(images)
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


@pytest.mark.parametrize("most_pixels", [1, 4_000, 1 << 16])  # a picture a pass, two, all of them
def test_regions_scored_together_are_torchmetrics_of_each(kornias_layers, monkeypatch, most_pixels):
    monkeypatch.setattr(lpips_module, "MOST_PIXELS", most_pixels)
    monkeypatch.setattr(reference, "_get_tv_model_features", lambda net, pretrained: kornias_layers)
    network, (prediction, target) = reference._LPIPS(net="vgg"), images()
    masks = [None, torch.arange(50).expand(40, 50) < 20, torch.zeros(40, 50, dtype=torch.bool), target[..., 0] < 0.3]
    found = [each["lpips"] for each in get_protocol("envgs").scores(prediction, target, masks, ("lpips",))]
    assert found[2] is None
    for mask, value in zip(masks, found, strict=True):
        if value is not None:
            white = [x if mask is None else x.where(mask[..., None], 1.0) for x in (prediction, target)]
            expected = network(*(x.permute(2, 0, 1)[None] for x in white), normalize=False)
            assert value == pytest.approx(float(expected), rel=1e-5)


def test_regions_of_one_picture_share_its_features(kornias_layers, monkeypatch):
    """A protocol that averages over the mask has one picture for all of them, and each region its own mean."""
    monkeypatch.setattr(reference, "_get_tv_model_features", lambda net, pretrained: kornias_layers)
    network, (prediction, target) = reference._LPIPS(net="vgg", spatial=True), images()
    prediction, target = ((x * 255 + 0.5).floor() / 255 for x in (prediction, target))
    masks, passes = [torch.arange(50).expand(40, 50) < end for end in (20, 30, 50)], []
    forward = vgg16.Vgg16.forward
    monkeypatch.setattr(vgg16.Vgg16, "forward", lambda self, x: passes.append(len(x)) or forward(self, x))
    found = get_protocol("strict").scores(prediction, target, masks, ("lpips",))
    spatial = network(*(x.permute(2, 0, 1)[None] for x in (prediction, target)), normalize=True)[0, 0]
    assert passes == [1, 1]
    for mask, scores in zip(masks, found, strict=True):
        assert scores["lpips"] == pytest.approx(float(spatial[mask].mean()), rel=1e-4)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_lpips_on_a_gpu_is_the_cpus_cuda(random_weights):
    """TF32, torch's default there, is off by 1e-3 of the value."""
    pair, mask = images(200, 300), torch.zeros(200, 300, dtype=torch.bool)
    mask[50:120, 30:250] = True
    for region in (None, mask):
        on_gpu = [None if region is None else region.cuda() for _ in range(2)]
        there = [lpips(*pair.cuda(), "[-1, 1]", own) for own in on_gpu]
        assert there[0] == pytest.approx(lpips(*pair, "[-1, 1]", region), rel=1e-5)
        assert there[0] == there[1]


def test_lpips_is_zero_for_equal_images_and_enters_the_scores(random_weights):
    prediction, target = images()
    protocol = get_protocol("envgs")
    assert protocol.not_computed == {}
    assert protocol.weights == "torchvision vgg16-397923af"
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


def test_lpips_as_a_loss_is_torchmetrics_with_its_gradient(kornias_layers, monkeypatch):
    monkeypatch.setattr(reference, "_get_tv_model_features", lambda net, pretrained: kornias_layers)
    network = reference._LPIPS(net="vgg")
    image, target = (x.requires_grad_() for x in images())
    first, second = (x.permute(2, 0, 1)[None] for x in (image, target))
    (expected,) = torch.autograd.grad(network(first, second, normalize=False).sum(), image)
    value = make_perceptual_loss("lpips")(image, target)
    (gradient,) = torch.autograd.grad(value, image)
    assert value.item() == pytest.approx(network(first, second, normalize=False).item(), rel=1e-4)
    assert expected.abs().max() > 0
    torch.testing.assert_close(gradient, expected, atol=1e-6, rtol=1e-3)


def test_lpips_as_a_loss_passes_no_gradient_where_all_features_are_zero(random_weights, monkeypatch):
    monkeypatch.setattr(vgg16.Vgg16, "forward", lambda self, image: [torch.relu(image - 1e6)] * 5)
    monkeypatch.setattr(lpips_module, "_heads_on", lambda device: [torch.ones(3)] * 5)
    image, target = images()
    make_perceptual_loss("lpips")(image.requires_grad_(), target).backward()
    assert image.grad is not None
    assert not image.grad.any()


@pytest.mark.parametrize("name", ["features", "lpips"])
def test_a_perceptual_loss_waits_for_no_device(name, random_weights):
    loss, (image, target) = make_perceptual_loss(name), images()
    loss(image, target)  # what is copied to a device once
    with WaitsForTheDevice() as waits:
        loss(image.requires_grad_(), target).backward()
    assert waits.found == []


def test_an_unknown_perceptual_loss_is_refused():
    with pytest.raises(ValueError, match="unknown perceptual loss 'vgg', expected one of features, lpips"):
        make_perceptual_loss("vgg")


def test_without_weights_lpips_is_none_with_a_reason(monkeypatch):
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    protocol = get_protocol()
    prediction, target = images()
    assert protocol.score(prediction, target)["lpips"] is None
    assert protocol.not_computed == {"lpips": "VGG-16 is switched off by ENVGS_BENCH_VGG16=off"}
    assert protocol.weights is None
    with pytest.raises(WeightsUnavailable):
        make_perceptual_loss()
    with pytest.raises(WeightsUnavailable):
        make_perceptual_loss("lpips")


def test_unknown_input_range_is_refused():
    with pytest.raises(ValueError, match=r"unknown input range 'bytes', expected one of \[0, 1\], \[-1, 1\]"):
        lpips(*images(), "bytes")
