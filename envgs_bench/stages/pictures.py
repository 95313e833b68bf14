"""The pictures that a run leaves of a test view: render, target, masks, and the layers that explain a render."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Rendering, View
from envgs_bench.run_folder import exact_normal_path, layer_path, mask_path, render_path, target_path

ERROR_GAIN = 4.0  # an error of a quarter of the range and more is white
LEVEL = 4  # of zlib: two and a half times as fast as the usual 6, and files a twentieth larger


def save_view(folder: Path, view: View, rendering: Rendering, unit: float) -> None:
    """Write renders/<view>.png, targets/<view>.png, masks/<region>/<view>.png and layers/<layer>/<view>.png.

    Layers are the method's own and "normal", "depth", "error"; colors are sRGB. Of a view that brings exact normals,
    targets/normal/<view>.png too, black where there is none.

    Args:
        unit: depth that is shown as middle gray, world units: see `depth_picture`.
    """
    save_pair(folder, view, rendering.color.cpu(), layer_pictures(rendering, unit))
    if view.normal is not None:
        known = view.normal.norm(dim=-1, keepdim=True) > 0.5
        save_png(exact_normal_path(folder, view.name), torch.where(known, view.normal / 2 + 0.5, torch.zeros(())))


def layer_pictures(rendering: Rendering, unit: float) -> dict[str, Tensor]:
    """The method's own layers and "normal", "depth", values in [0, 1]: [H, W], [H, W, 1] or [H, W, 3].

    Args:
        unit: as of `depth_picture`.
    """
    return rendering.layers | {
        "normal": functional.normalize(rendering.normal, dim=-1) / 2 + 0.5,
        "depth": depth_picture(rendering.depth, unit),
    }


def save_pair(folder: Path, view: View, image: Tensor, layers: Mapping[str, Tensor]) -> None:
    """As `save_view`, of a picture [H, W, 3] and the layers given; "error" is added."""
    target = view.rgb()
    save_png(render_path(folder, view.name), image)
    save_png(target_path(folder, view.name), target)
    for region, mask in view.masks.items():
        save_png(mask_path(folder, view.name, region), mask)
    for name, layer in {**layers, "error": error_picture(image, target)}.items():
        save_png(layer_path(folder, view.name, name), layer)


def depth_picture(depth: Tensor, unit: float) -> Tensor:
    """Gray in [0, 1] of a depth [H, W], unit² / (unit² + depth²): near is white, far and nothing (0) are black.

    The mapping is the scene's, not the picture's own, so that methods compare.
    """
    return torch.where(depth > 0, unit**2 / (unit**2 + depth**2), torch.zeros_like(depth))


def error_picture(image: Tensor, target: Tensor) -> Tensor:
    """Gray of the mean absolute difference of two [H, W, 3] images, times `ERROR_GAIN`: [H, W], black where equal."""
    return (image - target).abs().mean(dim=-1) * ERROR_GAIN


def depth_unit(cameras: Sequence[Camera]) -> float:
    """The mean distance of the cameras from their center, world units; 1 where they do not spread.

    Around an object it is about how far the object is: there a `depth_picture` is gray.
    """
    centers = torch.stack([camera.center for camera in cameras]).double()
    spread = float((centers - centers.mean(dim=0)).norm(dim=-1).mean())
    return spread if spread > 0 else 1.0


def save_png(path: Path, image: Tensor) -> None:
    """Write [H, W], [H, W, 1] or [H, W, 3] values in [0, 1] as an 8-bit PNG: see `as_bytes`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(as_bytes(image)).save(path, compress_level=LEVEL)


def as_bytes(image: Tensor) -> NDArray[np.uint8]:
    """Values in [0, 1], [H, W] or [H, W, 1 or 3], as bytes [H, W] or [H, W, 3], clamped and rounded as protocols do."""
    values = image.detach().float().clamp(0, 1).mul(255).add(0.5).floor().to(torch.uint8).cpu().numpy()
    return np.ascontiguousarray(values[..., 0] if values.shape[2:] == (1,) else values)
