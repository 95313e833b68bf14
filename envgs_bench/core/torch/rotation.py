"""Rotations from quaternions."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3], local to world, of quaternions [..., 4] (wxyz, any non-zero norm)."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    matrices: Tensor = torch.stack(entries, dim=-1).unflatten(-1, (3, 3))
    return matrices
