"""Spherical harmonics: from coefficients to color."""

from __future__ import annotations

import torch
from torch import Tensor

# Normalization constants of the real spherical harmonics, degree by degree.
C0 = 0.28209479177387814  # ½·√(1/π)
C1 = 0.4886025119029199  # √(3/4π)
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)  # ½√(15/π), ¼√(5/π), ¼√(15/π)
C3 = (
    0.5900435899266435,  # ¼·√(35/2π)
    2.890611442640554,  # ½·√(105/π)
    0.4570457994644658,  # ¼·√(21/2π)
    0.3731763325901154,  # ¼·√(7/π)
    1.445305721320277,  # ¼·√(105/π)
)


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """The real spherical harmonics Y of unit vectors [..., 3] up to `degree` (0 to 3), [..., (degree + 1)²].

    Order (l, m) = (0, 0), (1, −1), (1, 0), (1, 1), (2, −2), …; with the complex Y_l^m of physics (Condon–Shortley phase
    included) Y(l, m) = √2·Im Y_l^|m| for m < 0, Y_l^0 for m = 0, √2·Re Y_l^m for m > 0: the signs 3DGS files use.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [torch.full_like(x, C0)]
    if degree >= 1:
        basis += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        basis += [
            C2[0] * x * y,
            -C2[0] * y * z,
            C2[1] * (2 * zz - xx - yy),
            -C2[0] * x * z,
            C2[2] * (xx - yy),
        ]
    if degree >= 3:
        basis += [
            -C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            -C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -C3[2] * x * (4 * zz - xx - yy),
            C3[4] * z * (xx - yy),
            -C3[0] * x * (xx - 3 * yy),
        ]
    return torch.stack(basis, dim=-1)


def sh_color(sh: Tensor, offsets: Tensor) -> Tensor:
    """Color [..., 3] of coefficients [..., K, 3] seen along `offsets` [..., 3], of any length: max(0, Σ Yₖ·cₖ + ½).

    An offset of zero has no direction: Y is that of the zero vector, and no gradient reaches the offset.
    """
    squared = (offsets * offsets).sum(-1, keepdim=True)
    somewhere = squared > 0
    directions = torch.where(somewhere, offsets / torch.where(somewhere, squared, 1).sqrt(), 0)
    degree = round(sh.shape[-2] ** 0.5) - 1
    basis = sh_basis(directions, degree)
    return ((basis[..., None] * sh).sum(-2) + 0.5).clamp_min(0)
