"""Sites on the sphere (spherical Voronoi, Di Sario et al. 2025): what a set has in place of SH beyond the constant one.

| field | shape | what |
|---|---|---|
| site_colors | [N, 24] | of 8 sites, each one's color less the constant SH's |
| site_vectors | [N, 24] | each one's direction × how sharply its cell ends |
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from envgs_bench.core.gaussians import SITES

COLUMNS = {"site_colors": 3 * SITES, "site_vectors": 3 * SITES}
RATES = {"site_colors": 5e-4, "site_vectors": 3e-2}  # Adam's, of the authors' code
GOLDEN = torch.pi * (3 - 5**0.5)  # radians between two points of a spiral


def initial_sites(count: int) -> dict[str, Tensor]:
    """Fields of `count` primitives of one color: sites spread evenly over the sphere, their cells hardly bounded."""
    rows = torch.arange(SITES) + 0.5
    height, angle = 1 - 2 * rows / SITES, rows * GOLDEN
    ring = (1 - height.square()).sqrt()
    spread = torch.stack([ring * angle.cos(), height, ring * angle.sin()], dim=1)
    return {"site_colors": torch.zeros(count, 3 * SITES), "site_vectors": spread.flatten().repeat(count, 1)}


def sites_of(tensors: Mapping[str, Tensor], constant: Tensor) -> Tensor:
    """`GaussianSet.sh` [N, 8, 6] of a set with sites, and of what it shows from everywhere, [N, 1, 3]."""
    colors, vectors = (tensors[name].unflatten(1, (SITES, 3)) for name in COLUMNS)
    return torch.cat([constant + colors, vectors], dim=-1)
