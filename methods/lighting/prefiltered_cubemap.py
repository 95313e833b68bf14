"""A cube map as rough surfaces reflect it: levels filtered by GGX lobes of growing roughness, and the irradiance.

The second half of the split-sum approximation (Karis, Real Shading in Unreal Engine 4, 2013): a surface of roughness ρ,
looked at head-on, reflects toward r

    L(r, ρ) = Σ E(l)·(r·l) / Σ r·l,    l = 2(r·h)h − r,    h distributed as D_GGX(h; α = ρ²)·(r·h)

Each level is a fixed linear function of the map's texels, a sparse matrix that is made once for a map's size. Samples
read a smaller map the less likely they are (Křivánek and Colbert, Real-time Shading with Filtered Importance Sampling,
2008).
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from .cubemap import CubemapLayout, bilinear_texels, layout_of, sample_cubemap, texel_directions

ROUGHNESSES = (0.08, 0.29, 0.5, 1.0)  # of the levels; the first is the map itself, whose texels are as wide as its lobe
SAMPLES = (1, 32, 64, 128)  # directions that a texel of each level averages: the smaller a level, the more may be had
SMALLEST = 2  # texels along an edge
SHARPER = 1.0  # levels by which samples read a sharper map than their solid angle asks (Křivánek and Colbert)
SH_CONSTANTS = (0.282095, 0.488603, 1.092548, 0.315392, 0.546274)
SH_BANDS = (math.pi, 2 * math.pi / 3, math.pi / 4)  # of the clamped cosine (Ramamoorthi and Hanrahan 2001)


@dataclass(frozen=True)
class Prefilter:
    """What makes a map of one size into levels; `prefilter_of` makes it."""

    layouts: tuple[CubemapLayout, ...]  # of the levels
    sizes: tuple[int, ...]  # texels along their edges
    matrices: tuple[tuple[Tensor, Tensor], ...]  # of the levels but the first, and their transposes, sparse
    irradiance: Tensor  # [9, 6·S²] from the map's texels to the spherical harmonics of its irradiance / π


@dataclass(frozen=True)
class RoughMap:
    """A map's filtered levels, ready for lookup; colors of any range."""

    prefilter: Prefilter
    levels: tuple[Tensor, ...]  # [6, S, S, C]
    harmonics: Tensor  # [9, C]

    def specular(self, directions: Tensor, roughness: Tensor) -> Tensor:
        """What surfaces of `roughness` [R] reflect along `directions` [R, 3], [R, C]: differentiable in all.

        Linear in roughness between the levels' own; of the first level below its roughness.
        """
        found = torch.zeros(len(directions), self.levels[0].shape[-1], dtype=directions.dtype, device=directions.device)
        for index, (level, layout) in enumerate(zip(self.levels, self.prefilter.layouts, strict=True)):
            weight = _level_weight(roughness, index)
            found = found + weight[:, None] * sample_cubemap(level, directions, layout)
        return found

    def irradiance(self, normals: Tensor) -> Tensor:
        """∫ E(l)·max(0, n·l) dl / π at unit `normals` [R, 3], [R, C], of the map's lowest nine harmonics."""
        return _harmonics(normals) @ self.harmonics


@cache
def prefilter_of(size: int, device: torch.device | str = "cpu") -> Prefilter:
    """The prefilter of maps with `size` texels an edge. Made once for each size and device."""
    sizes = tuple(max(SMALLEST, size >> level) for level in range(len(ROUGHNESSES)))
    chain = _halvings(size)
    levels = list(zip(sizes, ROUGHNESSES, SAMPLES, strict=True))[1:]
    matrices = tuple(_filter(chain, *level, device=device) for level in levels)
    layouts = tuple(layout_of(each, device) for each in sizes)
    return Prefilter(layouts, sizes, matrices, _irradiance_matrix(size).float().to(device))


def rough_map(texels: Tensor, prefilter: Prefilter) -> RoughMap:
    """The filtered levels of `texels` [6, S, S, C], differentiable."""
    chain = [texels]
    while (size := chain[-1].shape[1] // 2) >= SMALLEST and chain[-1].shape[1] % 2 == 0:
        chain.append(functional.avg_pool2d(chain[-1].permute(0, 3, 1, 2), 2).permute(0, 2, 3, 1))
        assert chain[-1].shape[1] == size
    every = torch.cat([each.reshape(-1, texels.shape[-1]) for each in chain])
    filtered = [_SparseProduct.apply(every, *matrix) for matrix in prefilter.matrices]
    sizes = prefilter.sizes[1:]
    levels = [level.reshape(6, size, size, -1) for level, size in zip(filtered, sizes, strict=True)]
    harmonics = prefilter.irradiance.to(texels) @ chain[0].reshape(-1, texels.shape[-1])
    return RoughMap(prefilter, (texels, *levels), harmonics)


class _SparseProduct(torch.autograd.Function):
    """matrix @ dense, by two sparse matrices: PyTorch's own backward makes the transpose anew each time."""

    @staticmethod
    def forward(ctx: Any, dense: Tensor, matrix: Tensor, transposed: Tensor) -> Tensor:
        ctx.transposed = transposed
        return matrix.to(dense.dtype) @ dense

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return ctx.transposed.to(gradient.dtype) @ gradient.contiguous(), None, None


def _level_weight(roughness: Tensor, level: int) -> Tensor:
    """The hat function of a level over roughness [R]: 1 at its own, 0 at its neighbors', 1 beyond the ends."""
    own, weight = ROUGHNESSES[level], torch.ones_like(roughness)
    if level > 0:
        weight = torch.minimum(weight, (roughness - ROUGHNESSES[level - 1]) / (own - ROUGHNESSES[level - 1]))
    if level + 1 < len(ROUGHNESSES):
        weight = torch.minimum(weight, (ROUGHNESSES[level + 1] - roughness) / (ROUGHNESSES[level + 1] - own))
    return weight.clamp_min(0)


def _halvings(size: int) -> list[int]:
    sizes = [size]
    while sizes[-1] % 2 == 0 and sizes[-1] // 2 >= SMALLEST:
        sizes.append(sizes[-1] // 2)
    return sizes


def _filter(
    chain: list[int], size: int, roughness: float, samples: int, device: torch.device | str
) -> tuple[Tensor, Tensor]:
    """The matrix [6·size², Σ 6·s²] from the texels of all maps of the chain, one behind the other, to a level's; and
    its transpose."""
    outward = functional.normalize(texel_directions(size).reshape(-1, 3), dim=1)
    local, weights, halvings = _lobe(roughness, samples, chain[0])
    across, along = _frames(outward)
    starts = torch.tensor([0, *(6 * s * s for s in chain)]).cumsum(0)
    entries = []
    for halved in halvings.unique():
        level = min(int(halved), len(chain) - 1)
        x, y, z = local[halvings == halved].T.float()[:, :, None, None]
        row, texel, share = bilinear_texels((x * across + y * along + z * outward).reshape(-1, 3), chain[level])
        sample = weights[halvings == halved].float()[row // len(outward)]
        entries.append((row % len(outward), starts[level] + texel, sample * share))
    rows, columns, values = (torch.cat(each) for each in zip(*entries, strict=True))
    height, width = len(outward), int(starts[-1])
    matrix = _csr(rows, columns, values, (height, width))
    return matrix.to(device), _csr(columns, rows, values, (width, height)).to(device)


def _irradiance_matrix(size: int) -> Tensor:
    """[9, 6·size²]: each harmonic's share in the map, times what the clamped cosine leaves of its band."""
    directions = functional.normalize(texel_directions(size).double().reshape(-1, 3), dim=1)
    bands = torch.tensor([SH_BANDS[0], *3 * [SH_BANDS[1]], *5 * [SH_BANDS[2]]], dtype=torch.float64) / math.pi
    return (_harmonics(directions) * _solid_angles(size)[:, None] * bands).T


def _lobe(roughness: float, samples: int, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Directions [K, 3] of a GGX lobe about z, their weights [K], and how many times each reads a map halved."""
    alpha = roughness**2
    share = (torch.arange(samples, dtype=torch.float64) + 0.5) / samples
    azimuth = torch.arange(samples, dtype=torch.float64) * (math.pi * (3 - math.sqrt(5)))  # a sunflower's angles
    cosine = ((1 - share) / (1 + (alpha**2 - 1) * share)).sqrt()  # n·h
    sine = (1 - cosine.square()).sqrt()
    half = torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), cosine], dim=1)
    light = 2 * cosine[:, None] * half - torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    lit = light[:, 2] > 0
    density = alpha**2 / (math.pi * (cosine.square() * (alpha**2 - 1) + 1).square()) / 4  # of l: D·(n·h) / (4·v·h)
    solid_angle = 1 / (samples * density)
    texel = 4 * math.pi / (6 * size**2)
    halvings = (0.5 * (solid_angle / texel).log2() - SHARPER).round().clamp_min(0)
    weights = light[:, 2] * lit
    return light[lit], (weights / weights.sum())[lit], halvings[lit]


def _frames(normals: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors [N, 3] each, at right angles to unit normals and to each other."""
    axis = functional.one_hot(normals.abs().argmin(1), 3).to(normals)
    across = functional.normalize(torch.linalg.cross(axis, normals), dim=1)
    return across, torch.linalg.cross(normals, across)


def _harmonics(directions: Tensor) -> Tensor:
    """The real spherical harmonics [R, 9] up to degree 2 of unit directions [R, 3]."""
    x, y, z = directions.unbind(-1)
    c = SH_CONSTANTS
    one = c[0] * torch.ones_like(x)
    linear = [c[1] * y, c[1] * z, c[1] * x]
    return torch.stack(
        [one, *linear, c[2] * x * y, c[2] * y * z, c[3] * (3 * z * z - 1), c[2] * x * z, c[4] * (x * x - y * y)], dim=-1
    )


def _solid_angles(size: int) -> Tensor:
    """Of each texel of a map [6·size²], steradians: exact, by differences of atan2 (Manson and Sloan 2016)."""
    edge = torch.linspace(-1, 1, size + 1, dtype=torch.float64)
    x, y = edge[:, None], edge[None, :]
    area = torch.atan2(x * y, (x * x + y * y + 1).sqrt())
    face = area[1:, 1:] - area[:-1, 1:] - area[1:, :-1] + area[:-1, :-1]
    return face.reshape(-1).repeat(6)


def _csr(rows: Tensor, columns: Tensor, values: Tensor, shape: tuple[int, int]) -> Tensor:
    """The sparse matrix of this shape with these entries, [K] each; those at the same place add up."""
    order = rows.argsort(stable=True)
    starts = torch.zeros(shape[0] + 1, dtype=torch.long)
    starts[1:] = rows.bincount(minlength=shape[0]).cumsum(0)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sparse CSR tensor support is in beta state")
        return torch.sparse_csr_tensor(starts, columns[order], values[order], shape, check_invariants=False)
