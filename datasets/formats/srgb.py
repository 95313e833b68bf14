"""The sRGB transfer curve (IEC 61966-2-1), both ways, on arrays as they are.

kornia.color has it for tensors [..., 3, H, W], to 2e-16; importing that takes 0.2 s, and textures have no such shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def to_linear(encoded: ArrayLike) -> NDArray[np.floating]:
    """Linear light of sRGB-encoded values in [0, 1], in their own precision."""
    values = np.asarray(encoded)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """sRGB encoding of linear light; values outside [0, 1] are clipped first."""
    values = np.clip(np.asarray(linear, dtype=np.float64), 0, 1)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)
