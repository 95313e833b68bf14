"""VGG-16's convolutions: the features that LPIPS and the perceptual loss compare."""

from __future__ import annotations

import os
from functools import cache

import torch
from torch import Tensor, nn

from .weights import WEIGHTS_VARIABLE, WeightsUnavailable, find_weights


class Vgg16(nn.Module):
    """The 13 convolutions of VGG-16 (Simonyan and Zisserman 2015), kornia's layers, named as torchvision names them."""

    source: str  # where the weights come from, once there are any

    def __init__(self) -> None:
        from kornia.feature.dedode.vgg import cfgs, make_layers  # takes 0.2 s: where there are weights

        super().__init__()
        *layers, _ = make_layers(cfgs["D"])  # the last pooling is the classifier's
        self.features = nn.Sequential(*layers)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Features at the end of each of the five stages, [B, C, H / 2^k, W / 2^k].

        Args:
            images: [B, 3, H, W], of ImageNet's mean 0 and deviation 1, at least 16×16 pixels.
        """
        features = []
        for layer in self.features:
            if isinstance(layer, nn.MaxPool2d):
                features.append(images)
            images = layer(images)
        return [*features, images]


def convolution_names() -> list[str]:
    """The names of the 13 convolutions, from the image on: "features.0", "features.2", …, "features.28"."""
    with torch.device("meta"):
        return [name for name, layer in Vgg16().named_modules() if isinstance(layer, nn.Conv2d)]


def load_vgg16(device: torch.device | str = "cpu") -> Vgg16:
    """The network with its weights, frozen; loaded once a process, and moved to where it was asked for last.

    Raises:
        WeightsUnavailable: at once where an earlier call in this process failed.
    """
    device = torch.device(device)
    # Channels last, oneDNN does the convolutions in 70% of the time.
    layout = torch.channels_last if device.type == "cpu" else torch.contiguous_format
    return _loaded().to(device, memory_format=layout)  # type: ignore[call-overload]  # PyTorch's stubs lack this one


def weights_source() -> str:
    """Where the weights come from, `Vgg16.source`; raises as `load_vgg16`, and moves nothing."""
    return _loaded().source


def _loaded() -> Vgg16:
    loaded = _load(os.environ.get(WEIGHTS_VARIABLE, ""))
    if isinstance(loaded, str):
        raise WeightsUnavailable(loaded)
    return loaded


@cache
def _load(given: str) -> Vgg16 | str:
    """The network, or why there is none. `given`, the environment's choice, is there to be part of the cache's key."""
    try:
        weights = find_weights()
    except (WeightsUnavailable, OSError) as error:
        return str(error)
    with torch.device("meta"):
        network = Vgg16()
    network.load_state_dict(weights.read(), assign=True)
    network.source = weights.source
    return network.requires_grad_(False).eval()
