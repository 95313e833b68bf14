"""GaussianSet: the primitives that every method draws, in the units the core works in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

MAX_EXTRAS = 8
SITES = 8


@dataclass(frozen=True)
class GaussianSet:
    """N Gaussian primitives: surfels (2D Gaussians) where `scales` has two columns, 3D Gaussians where it has three.

    Every field is *activated*: opacities are probabilities and scales are standard deviations, not logits or
    logarithms. The set carries gradients as ordinary tensors do.

    A surfel lies in the plane of its first two axes, t_u and t_v, the first two columns of its rotation; the third is
    its normal (2D Gaussian Splatting, Eq. 1 of the EnvGS paper). Its support is u²+v² ≤ min(3², 2·ln(255·opacity)):
    where a response falls below 1/255 it is nowhere drawn, neither rasterized nor traced.

    Raises:
        TypeError: a field is no floating-point tensor.
        ValueError: shapes, dtypes or devices disagree; the message names the field and its shape.
    """

    means: Tensor
    """[N, 3] centers, world frame."""
    quaternions: Tensor
    """[N, 4] wxyz, local to world, any non-zero norm."""
    scales: Tensor
    """[N, 2] or [N, 3] standard deviations along the local axes, > 0, world units."""
    opacities: Tensor
    """[N] in [0, 1]."""
    sh: Tensor
    """[N, K, 3] spherical harmonics, K = (degree + 1)², degree 0 to 3; color = max(0, SH + 0.5). Or [N, 8, 6]: a row a
    site (spherical Voronoi), its color c and a vector s: color = max(0, Σ softmax(s·d)·c), d the unit direction."""
    extras: Tensor | None = None
    """[N, E] further values to blend as color is (EnvGS: β), E ≤ 8."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            if not isinstance(value, Tensor) or not value.is_floating_point():
                raise TypeError(f"GaussianSet.{field.name} must be a floating-point tensor, got {type(value).__name__}")
            if value.dtype != self.means.dtype or value.device != self.means.device:
                raise ValueError(
                    f"GaussianSet.{field.name} is {value.dtype} on {value.device}, "
                    f"but means is {self.means.dtype} on {self.means.device}: convert one"
                )
        n = self.means.shape[0] if self.means.ndim == 2 else -1
        expected: dict[str, list[tuple[int, ...]]] = {
            "means": [(n, 3)],
            "quaternions": [(n, 4)],
            "scales": [(n, 2), (n, 3)],
            "opacities": [(n,)],
            "sh": [*((n, (degree + 1) ** 2, 3) for degree in range(4)), (n, SITES, 6)],
        }
        if self.extras is not None:
            expected["extras"] = [(n, e) for e in range(MAX_EXTRAS + 1)]
        for name, shapes in expected.items():
            shape = tuple(getattr(self, name).shape)
            if shape not in shapes:
                raise ValueError(f"GaussianSet.{name} has shape {shape}, expected one of {shapes} (N from means)")

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def sh_degree(self) -> int:
        """Raises ValueError of a set whose colors are those of sites."""
        if self.has_sites:
            raise ValueError("this GaussianSet has no SH degree: its colors are those of sites")
        return math.isqrt(self.sh.shape[1]) - 1

    @property
    def has_sites(self) -> bool:
        """Whether colors are those of sites rather than spherical harmonics."""
        return self.sh.shape[2] == 6

    @property
    def is_surfels(self) -> bool:
        return self.scales.shape[1] == 2

    @property
    def device(self) -> torch.device:
        return self.means.device

    def map(self, function: Callable[[Tensor], Tensor]) -> GaussianSet:
        """The set with `function` applied to each of its tensors: `gaussians.map(lambda x: x[keep])`."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: function(value) for name, value in values.items() if value is not None})

    def to(self, target: torch.device | torch.dtype | str) -> GaussianSet:
        return self.map(lambda tensor: tensor.to(target))
