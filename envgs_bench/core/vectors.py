"""Unit vectors, and rotations of vectors."""

from __future__ import annotations

import torch
from torch import Tensor


def unit(vectors: Tensor) -> Tensor:
    """Vectors [..., D] at length 1; those shorter than 1e-12 stay short. Half the time of `functional.normalize`."""
    return vectors * vectors.square().sum(-1, keepdim=True).clamp_min(1e-24).rsqrt()


def rotated(vectors: Tensor, rotations: Tensor) -> Tensor:
    """Vectors [..., 3] turned about the axes of rotation vectors [..., 3] by their length in radians (Rodrigues)."""
    angle, axis = rotations.norm(dim=-1, keepdim=True), unit(rotations)
    along = (axis * vectors).sum(dim=-1, keepdim=True) * axis
    turned: Tensor = along + angle.cos() * (vectors - along) + angle.sin() * torch.linalg.cross(axis, vectors)
    return turned
