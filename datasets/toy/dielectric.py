"""Light at the surface of a clear solid: Fresnel's reflectance and Snell's refraction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


def fresnel(cosine: Array, ratio: Array) -> Array:
    """Share of unpolarized light that is reflected, [R] in [0, 1]; 1 where it is reflected totally.

    Args:
        cosine: [R] between the ray and the normal that faces it, in [0, 1].
        ratio: [R] index of refraction on the ray's side over that beyond.
    """
    beyond = _cosine_beyond(cosine, ratio)
    with np.errstate(invalid="ignore"):  # 0/0 of a grazing ray whose refracted one grazes too
        across = (ratio * cosine - beyond) / (ratio * cosine + beyond)
        along = (ratio * beyond - cosine) / (ratio * beyond + cosine)
    return np.where(beyond > 0, (across**2 + along**2) / 2, 1.0).astype(cosine.dtype)


def refract(directions: Array, normals: Array, ratio: Array) -> Array:
    """Unit directions [R, 3] beyond the surface, by Snell's law; along the surface where there is none.

    Args:
        directions: [R, 3] unit.
        normals: [R, 3] unit, facing the rays.
        ratio: as of `fresnel`.
    """
    cosine = -np.einsum("ri,ri->r", directions, normals)
    bent = ratio[:, None] * directions + (ratio * cosine - _cosine_beyond(cosine, ratio))[:, None] * normals
    return bent / np.linalg.norm(bent, axis=1, keepdims=True)


def _cosine_beyond(cosine: Array, ratio: Array) -> Array:
    """Between the refracted ray and the normal, 0 under total reflection: sin θ₂ = ratio·sin θ₁."""
    return np.sqrt(np.maximum(0, 1 - ratio**2 * (1 - cosine**2)))
