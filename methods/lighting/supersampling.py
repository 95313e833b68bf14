"""Several reflected rays a pixel: a drawn image as surfaces between its pixels, and colors averaged over pixels again.

A curved mirror turns the rays of neighboring pixels far apart, and a ray through a pixel's center stands for all that
the pixel shows of the surroundings. What it mirrors is then undersampled, where a photograph has it averaged.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Rendering

TINY = 1e-12


def finer(image: Rendering, camera: Camera, factor: int) -> tuple[Rendering, Camera]:
    """Alpha, depth, normal and extras of `image` at `factor`² points a pixel, and the camera whose pixels these are.

    Blended values are interpolated bilinearly between pixel centers, depth by its inverse, which is linear over the
    image of a plane. Differentiable; colors and hits stay as they are.
    """
    if factor == 1:
        return image, camera
    alpha = image.alpha[..., None]
    inverse = torch.where(image.depth > 0, image.alpha / image.depth.clamp_min(TINY), 0.0)[..., None]
    maps = torch.cat([alpha, inverse, image.normal, image.extras], dim=-1)
    between = functional.interpolate(
        maps.movedim(-1, 0)[None], scale_factor=factor, mode="bilinear", align_corners=False
    )[0]
    alpha, inverse = between[0], between[1]
    normal, extras = between[2:5].movedim(0, -1), between[5:].movedim(0, -1)
    depth = torch.where(inverse > 0, alpha / inverse.clamp_min(TINY), 0.0)
    surfaces = replace(image, alpha=alpha, depth=depth, normal=normal, extras=extras)
    return surfaces, camera.resized(factor * camera.width, factor * camera.height)


def repeated(values: Tensor, factor: int) -> Tensor:
    """Values [H, W, C] of pixels at each of their `factor`² points, [factor·H, factor·W, C]."""
    if factor == 1:
        return values
    return values.repeat_interleave(factor, dim=0).repeat_interleave(factor, dim=1)


def averaged(values: Tensor, factor: int) -> Tensor:
    """Means [H, W, C] over the `factor`² points of each pixel of values [factor·H, factor·W, C]."""
    if factor == 1:
        return values
    height, width, channels = values.shape
    return values.reshape(height // factor, factor, width // factor, factor, channels).mean(dim=(1, 3))
