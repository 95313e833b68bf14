"""Resampling: pictures at another size, by area."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def resample(pixels: NDArray, width: int, height: int) -> NDArray[np.float32]:
    """The picture [H, W, C] at another size; each pixel is the mean of the area it covers, of the values as they are.

    Exact for sizes that do not divide, where Pillow's box filter takes whole pixels and so moves the picture by up to
    half of one against its intrinsics. skimage.transform.resize_local_mean by sparse matrices instead of dense ones.
    """
    channels = pixels.shape[2]
    result = pixels.astype(np.float32)
    if result.shape[0] != height:
        result = _overlaps(result.shape[0], height) @ result.reshape(result.shape[0], -1)
    result = result.reshape(height, -1, channels)
    if result.shape[1] != width:
        sideways = result.swapaxes(0, 1).reshape(result.shape[1], -1)
        result = (_overlaps(result.shape[1], width) @ sideways).reshape(width, height, channels).swapaxes(0, 1)
    return np.ascontiguousarray(result)


@lru_cache(maxsize=64)
def _overlaps(length: int, bins: int) -> sparse.csr_array:
    """[bins, length]: the share of each of a line's `length` pixels in the means over its `bins` equal parts."""
    edges = np.linspace(0, length, bins + 1)
    first, last = np.floor(edges[:-1]).astype(int), np.ceil(edges[1:]).astype(int)
    rows = np.repeat(np.arange(bins), last - first)
    columns = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)])
    common = np.minimum(edges[rows + 1], columns + 1) - np.maximum(edges[rows], columns)
    shares = (np.maximum(common, 0) * (bins / length)).astype(np.float32)
    return sparse.csr_array((shares, (rows, columns)), shape=(bins, length))
