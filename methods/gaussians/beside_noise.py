"""Which share of pictures' squared error is not the photographs' noise, told by what neighboring pixels share of it."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from envgs_bench.core import Rendering, View


def share_beside_noise(drawn: Iterable[tuple[Rendering, View]]) -> float:
    """Of the squared error of pictures of their views, in [0, 1].

    Noise differs from pixel to pixel, and what a model has wrong reaches over several. So errors' products over a
    distance of one and two pixels have no noise. Of distance zero they are told from these two: as if they fell by the
    same factor from each distance to the next. Noise that neighbors share, as a JPEG's, counts as the model's. Texture
    as fine as pixels, which is not learned yet, counts as noise.
    """
    sums = torch.stack([_products(picture.color - view.rgb(picture.color.device)) for picture, view in drawn])
    alone, one, two = sums.double().sum(dim=0).tolist()
    if alone <= 0 or two <= 0 < one:
        return 1.0
    return min(one * one / (alone * two), 1.0) if one > 0 else 0.0


def _products(error: Tensor) -> Tensor:
    """Means of an error [H, W, 3] times itself, and times what is one and two pixels to its right or below: [3]."""
    means = [error.square().mean()]
    for far in (1, 2):
        means.append(((error[far:] * error[:-far]).mean() + (error[:, far:] * error[:, :-far]).mean()) / 2)
    return torch.stack(means)
