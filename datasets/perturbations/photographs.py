"""Training photographs that were taken badly: exposure, white balance, blur, noise, compression."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from envgs_bench.core import Scene

Change = Callable[[Tensor, np.random.Generator], Tensor]  # a picture [3, H, W] in [0, 1], sRGB


def expose_differently(scene: Scene, stops: float, rng: np.random.Generator) -> Scene:
    """Each training photograph's linear light times 2^s, with s normal of deviation `stops`."""
    return _with_photographs(scene, lambda picture, own: _lit(picture, np.full(3, 2 ** (stops * own.normal()))), rng)


def balance_differently(scene: Scene, deviation: float, rng: np.random.Generator) -> Scene:
    """Red and blue of each training photograph's linear light times e^g, with g normal, one a channel; green stays."""

    def change(picture: Tensor, own: np.random.Generator) -> Tensor:
        red, blue = np.exp(deviation * own.normal(size=2))
        return _lit(picture, np.array([red, 1.0, blue]))

    return _with_photographs(scene, change, rng)


def blur(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A Gaussian blur with a standard deviation of this share of the width, as a lens out of focus."""
    from kornia.filters import gaussian_blur2d

    def change(picture: Tensor, own: np.random.Generator) -> Tensor:
        sigma = share * picture.shape[2]
        size = 2 * int(np.ceil(4 * sigma)) + 1
        padding = "reflect" if size // 2 < min(picture.shape[1:]) else "replicate"
        return gaussian_blur2d(picture[None], (size, size), (sigma, sigma), padding)[0]

    return _with_photographs(scene, change, rng)


def add_noise(scene: Scene, deviation: float, rng: np.random.Generator) -> Scene:
    """Normal noise of this deviation on each channel of each pixel, sRGB in [0, 1]; then clamped."""

    def change(picture: Tensor, own: np.random.Generator) -> Tensor:
        return picture + deviation * torch.from_numpy(own.standard_normal(picture.shape, dtype=np.float32))

    return _with_photographs(scene, change, rng)


def compress(scene: Scene, quality: float, rng: np.random.Generator) -> Scene:
    """Each training photograph as a JPEG of this quality gives it back, its colors subsampled (4:2:0)."""

    def change(picture: Tensor, own: np.random.Generator) -> Tensor:
        buffer = io.BytesIO()
        Image.fromarray(_bytes(picture).numpy()).save(buffer, "JPEG", quality=int(quality), subsampling="4:2:0")
        return torch.from_numpy(np.array(Image.open(buffer))).permute(2, 0, 1) / 255

    return _with_photographs(scene, change, rng)


def _with_photographs(scene: Scene, change: Change, rng: np.random.Generator) -> Scene:
    """The scene with changed training photographs: a generator a view, so that views do not depend on each other."""
    streams = rng.spawn(len(scene.train))
    pictures = [
        _bytes(change(view.rgb().permute(2, 0, 1), own)) for view, own in zip(scene.train, streams, strict=True)
    ]
    views = [replace(view, image=picture) for view, picture in zip(scene.train, pictures, strict=True)]
    return replace(scene, train=views)


def _lit(picture: Tensor, gains: np.ndarray) -> Tensor:
    """The picture with the linear light of its channels times `gains` [3]."""
    from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb

    factors = torch.from_numpy(gains).to(picture)[:, None, None]
    return linear_rgb_to_rgb((rgb_to_linear_rgb(picture) * factors).clamp(0, 1))


def _bytes(picture: Tensor) -> Tensor:
    """[3, H, W] floats to [H, W, 3] bytes, clamped and rounded."""
    return (255 * picture.clamp(0, 1)).round().byte().permute(1, 2, 0).contiguous()
