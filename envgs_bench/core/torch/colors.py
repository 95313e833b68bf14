"""What color a primitive shows toward a direction: of its spherical harmonics, or of its sites."""

from __future__ import annotations

import torch
from torch import Tensor

from .sh import sh_color


def seen_color(sh: Tensor, offsets: Tensor) -> Tensor:
    """Color [..., 3] of `GaussianSet.sh` [..., K, 3] or [..., S, 6], seen along `offsets` [..., 3], of any length."""
    return site_color(sh, offsets) if sh.shape[-1] == 6 else sh_color(sh, offsets)


def site_color(sites: Tensor, offsets: Tensor) -> Tensor:
    """Color [..., 3] of sites [..., S, 6], rows of a color c and a vector s: max(0, Σ softmax(s·d)·c).

    Spherical Voronoi (Di Sario et al. 2025), with a site's sharpness as its vector's length. An offset of zero has no
    direction: all sites weigh alike, and no gradient reaches the offset.
    """
    squared = (offsets * offsets).sum(-1, keepdim=True)
    somewhere = squared > 0
    directions = torch.where(somewhere, offsets / torch.where(somewhere, squared, 1).sqrt(), 0)
    colors, vectors = sites.split(3, dim=-1)
    weights = (vectors * directions[..., None, :]).sum(-1).softmax(-1)
    color: Tensor = (weights[..., None] * colors).sum(-2)
    return color.clamp_min(0)
