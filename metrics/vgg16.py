"""VGG-16's convolutions with the weights that LPIPS and the perceptual loss are defined on, and where to find them.

The weights are torchvision's ImageNet classifier (`vgg16-397923af.pth`, 528 MB). They are looked for in this order:

1. the file that the environment variable `ENVGS_BENCH_VGG16` names ("off": do without);
2. torch.hub's cache, `~/.cache/torch/hub/checkpoints/` unless `TORCH_HOME` says otherwise;
3. the network, once, into that cache.

A file of any other content is refused: with other weights the numbers would look like LPIPS and not be it.
"""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import torch
from torch import Tensor, nn

WEIGHTS_URL = "https://download.pytorch.org/models/vgg16-397923af.pth"
WEIGHTS_SHA256 = "397923af"  # the first digits, as torch.hub checks them
WEIGHTS_VARIABLE = "ENVGS_BENCH_VGG16"
TIMEOUT_SECONDS = 5.0  # without an answer from the network

STAGES = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))  # channels; max-pooled in between
MINIMUM_SIZE = 16  # pixels: smaller images vanish in the four poolings


class WeightsUnavailable(RuntimeError):
    """The weights cannot be had here; the message says why and what to do."""


class Vgg16(nn.Module):
    """The 13 convolutions of VGG-16 (Simonyan and Zisserman 2015), named as torchvision names them."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        self.outputs: list[int] = []  # indices of relu1_2, relu2_2, relu3_3, relu4_3, relu5_3
        channels = 3
        for stage in STAGES:
            if layers:
                layers.append(nn.MaxPool2d(2))
            for width in stage:
                layers += [nn.Conv2d(channels, width, kernel_size=3, padding=1), nn.ReLU(inplace=True)]
                channels = width
            self.outputs.append(len(layers) - 1)
        self.features = nn.Sequential(*layers)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Features at the end of each of the five stages, [B, C, H / 2^k, W / 2^k].

        Args:
            images: [B, 3, H, W], of ImageNet's mean 0 and deviation 1, at least 16×16 pixels.
        """
        features = []
        for index, layer in enumerate(self.features):
            images = layer(images)
            if index in self.outputs:
                features.append(images)
        return features


def load_vgg16(device: torch.device | str = "cpu") -> Vgg16:
    """The network with its weights, frozen; loaded once a process.

    Raises:
        WeightsUnavailable: at once where an earlier call in this process failed.
    """
    loaded = _load(os.environ.get(WEIGHTS_VARIABLE, ""))
    if isinstance(loaded, str):
        raise WeightsUnavailable(loaded)
    return loaded.to(device)


def why_unavailable() -> str | None:
    """Why `load_vgg16` fails here, or None where it works. Loads, and so may download."""
    try:
        load_vgg16()
    except WeightsUnavailable as error:
        return str(error)
    return None


def find_weights(download: bool = True) -> Path:
    """The path of the weights, their content checked.

    Args:
        download: fetch them where they are not on this machine.

    Raises:
        WeightsUnavailable: they are not to be had, or the file has another content.
    """
    given = os.environ.get(WEIGHTS_VARIABLE, "")
    if given == "off":
        raise WeightsUnavailable(f"VGG-16 is switched off by {WEIGHTS_VARIABLE}=off")
    cached = Path(torch.hub.get_dir()) / "checkpoints" / Path(WEIGHTS_URL).name
    path = Path(given).expanduser() if given else cached
    remedy = f"download {WEIGHTS_URL} and set {WEIGHTS_VARIABLE} to its path, or put it at {cached}"
    if not path.is_file():
        if given:
            raise WeightsUnavailable(f"{WEIGHTS_VARIABLE} names {path}, which is no file: {remedy}")
        if not download:
            raise WeightsUnavailable(f"VGG-16's weights are not on this machine: {remedy}")
        _download(cached, remedy)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if not digest.startswith(WEIGHTS_SHA256):
        raise WeightsUnavailable(
            f"{path} is not torchvision's VGG-16 for ImageNet (SHA-256 {digest[:8]}…, expected {WEIGHTS_SHA256}…): "
            f"truncated, or other weights; {remedy}"
        )
    return path


def make_perceptual_loss(device: torch.device | str = "cpu") -> Callable[[Tensor, Tensor], Tensor]:
    """L_perc = ‖Φ(I) − Φ(I_gt)‖₁ (EnvGS paper, Eq. 10) as a function of two [H, W, 3] images in [0, 1], a scalar.

    Φ are the features at the end of VGG-16's five stages; the norm is the mean over each stage's values, summed over
    the stages. Differentiable in the first image.

    Raises:
        WeightsUnavailable: by this function, not by the one it returns.
    """
    network = load_vgg16(device)
    mean = torch.tensor([0.485, 0.456, 0.406], device=device)
    deviation = torch.tensor([0.229, 0.224, 0.225], device=device)

    def features(image: Tensor) -> list[Tensor]:
        return network(((image - mean) / deviation).permute(2, 0, 1)[None])

    def perceptual_loss(image: Tensor, target: Tensor) -> Tensor:
        with torch.no_grad():
            expected = features(target)
        differences = [(a - b).abs().mean() for a, b in zip(features(image), expected, strict=True)]
        return torch.stack(differences).sum()

    return perceptual_loss


@cache
def _load(given: str) -> Vgg16 | str:
    """The network, or why there is none. `given`, the environment's choice, is there to be part of the cache's key."""
    try:
        path = find_weights()
    except (WeightsUnavailable, OSError) as error:
        return str(error)
    state = torch.load(path, map_location="cpu", weights_only=True)
    with torch.device("meta"):
        network = Vgg16()
    convolutions = {name: value for name, value in state.items() if name.startswith("features.")}
    network.load_state_dict(convolutions, assign=True)
    return network.requires_grad_(False).eval()


def _download(path: Path, remedy: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with _network_timeout(TIMEOUT_SECONDS):
            torch.hub.download_url_to_file(WEIGHTS_URL, str(path), hash_prefix=WEIGHTS_SHA256)
    except (OSError, RuntimeError) as error:
        raise WeightsUnavailable(f"VGG-16's weights could not be downloaded ({error}): {remedy}") from error


@contextmanager
def _network_timeout(seconds: float) -> Iterator[None]:
    """torch.hub waits for ever on a network that swallows packets, unless sockets have a default timeout."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(seconds)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before)
