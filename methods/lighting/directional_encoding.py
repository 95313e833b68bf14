"""Integrated directional encoding: directions as spherical harmonics, of which roughness leaves the low degrees.

Ref-NeRF (Verbin et al., CVPR 2022), Sec. 4.1: the mean of the complex Y_l^m over a von Mises-Fisher lobe of
concentration κ around a direction, which is close to exp(−l(l + 1) / 2κ)·Y_l^m of the direction itself.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from numpy.polynomial.legendre import Legendre
from numpy.polynomial.polynomial import Polynomial
from torch import Tensor

DEGREES = (1, 2, 4, 8)
HARMONICS = tuple((degree, order) for degree in DEGREES for order in range(degree + 1))  # (l, m), m ≥ 0
SIZE = 2 * len(HARMONICS)


def encoded(directions: Tensor, spread: Tensor) -> Tensor:
    """The encoding [N, SIZE] of unit `directions` [N, 3]: all real parts in the order of HARMONICS, then all imaginary.

    Args:
        spread: [N, 1] 1/κ ≥ 0 of each direction's lobe; 0: the direction alone.
    """
    of_height, falls = _tables(directions.device)
    x, y, z = directions.unbind(-1)
    cosine, sine = [torch.ones_like(x)], [torch.zeros_like(x)]  # of m·φ, times sinᵐθ
    for _ in range(DEGREES[-1]):
        cosine, sine = [*cosine, x * cosine[-1] - y * sine[-1]], [*sine, x * sine[-1] + y * cosine[-1]]
    heights = torch.stack(_powers(z), dim=-1) @ of_height
    heights = heights * (-falls * spread).exp()
    around = [torch.stack([parts[order] for _, order in HARMONICS], dim=-1) for parts in (cosine, sine)]
    return torch.cat([heights * part for part in around], dim=-1)


def _powers(z: Tensor) -> list[Tensor]:
    powers = [torch.ones_like(z)]
    for _ in range(DEGREES[-1]):
        powers.append(powers[-1] * z)
    return powers


@cache
def _tables(device: torch.device) -> tuple[Tensor, Tensor]:
    """The harmonics over sinᵐθ·exp(imφ) as polynomials in z, [powers, harmonics], and their l(l + 1)/2 [harmonics]."""
    columns = np.zeros((DEGREES[-1] + 1, len(HARMONICS)))
    for column, (degree, order) in enumerate(HARMONICS):
        polynomial = Legendre.basis(degree).convert(kind=Polynomial).deriv(order)
        norm = (2 * degree + 1) / (4 * math.pi) * math.factorial(degree - order) / math.factorial(degree + order)
        columns[: len(polynomial.coef), column] = (-1) ** order * math.sqrt(norm) * polynomial.coef
    falls = [degree * (degree + 1) / 2 for degree, _ in HARMONICS]
    return torch.from_numpy(columns).float().to(device), torch.tensor(falls, device=device)
