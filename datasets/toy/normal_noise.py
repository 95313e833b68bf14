"""Normals as an estimator would give them: wrong by a chosen angle, smoothly, a whole region at a time."""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal import oaconvolve

Array = NDArray[np.floating[Any]]

# standard deviation of the blur in picture widths, and its share of the variance
BANDS = ((1 / 4, 0.5), (1 / 12, 0.3), (1 / 40, 0.2))


def noisy_normals(normals: Array, directions: Array, mean_degrees: float, rng: np.random.Generator) -> Array:
    """The normals [H, W, 3], each turned by a rotation vector that varies smoothly over the picture.

    Monocular estimators err by whole surfaces and by gentle waves across them, not by pixels: the rotation's three
    components are independent Gaussian fields with half of the variance at a quarter of the picture's width, the rest
    at a twelfth and a fortieth (`BANDS`). The part of a rotation across a normal is what turns it: two components of
    deviation σ, so the angle follows Rayleigh's distribution, whose mean is σ·√(π/2). What would then face away from
    the camera is mirrored back to face it.

    Args:
        normals: [H, W, 3] unit, facing the camera; 0 where unknown, which stays.
        directions: [H, W, 3] of the rays through the pixels, of any length.
        mean_degrees: the angle's mean over many views; one view's own mean differs, as estimators' do.
    """
    return turned_normals(normals, directions, smooth_rotations(normals.shape[:2], mean_degrees, rng))


def smooth_rotations(shape: tuple[int, int], mean_degrees: float, rng: np.random.Generator) -> Array:
    """The rotation vectors [H, W, 3], radians."""
    deviation = np.radians(mean_degrees) / np.sqrt(np.pi / 2)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        fields = [_bands(shape, rng, pool) for _ in range(3)]
        return deviation * np.stack([sum(band.result() for band in bands) for bands in fields], axis=-1)


def turned_normals(normals: Array, directions: Array, rotation: Array) -> Array:
    """The normals turned, and mirrored back where they would then face away from the camera."""
    turned = _rotated(normals, rotation)
    sight = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    along = np.sum(turned * sight, axis=-1, keepdims=True)
    return turned - 2 * np.maximum(along, 0) * sight


def _bands(shape: tuple[int, int], rng: np.random.Generator, pool: ThreadPoolExecutor) -> list[Future[Array]]:
    """What adds up to a Gaussian field [H, W] of deviation 1: noise a band, drawn here, blurred in the pool."""
    bands = []
    for blur, share in BANDS:
        sigma = blur * shape[1]
        margin = int(np.ceil(4 * sigma))
        white = rng.normal(size=(shape[0] + 2 * margin, shape[1] + 2 * margin))
        bands.append(pool.submit(_blurred, white, sigma, margin, share))
    return bands


def _blurred(white: Array, sigma: float, margin: int, share: float) -> Array:
    """White noise, blurred and without its margin, of deviation √share."""
    kernel = ndimage.gaussian_filter1d(np.eye(1, 2 * margin + 1, margin)[0], sigma)
    # By Fourier transforms: at 800 pixels the widest kernel has 1,601 taps.
    smooth = oaconvolve(oaconvolve(white, kernel[:, None], "valid", axes=0), kernel[None], "valid", axes=1)
    return np.sqrt(share) * smooth / np.sum(kernel**2)  # the blur leaves (Σ k²)² of the variance, in two passes


def _rotated(vectors: Array, rotation: Array) -> Array:
    """Each vector turned about the axis of its rotation vector by that one's length (Rodrigues' formula)."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    axis = rotation / np.maximum(angle, 1e-12)
    along = np.sum(axis * vectors, axis=-1, keepdims=True)
    return np.cos(angle) * vectors + np.sin(angle) * np.cross(axis, vectors) + (1 - np.cos(angle)) * along * axis
