"""Sizes that the kernels and what launches them share, written here alone.

`CONSTANTS` reach every kernel as macros, what depends on the kind of set those that ask for it; the kernels check their
structs against them when they are compiled. A float here is 4 bytes.
"""

from __future__ import annotations

from ..gaussians import SITES

CONSTANTS = {
    "SITES": SITES,  # of a primitive whose colors are those of sites
    # rasterizer
    "TILE": 16,  # pixels, both ways
    "SHARING_WARPS": 8,  # of a block that draws an area of a tile
    "CAMERA_FLOATS": 37,
    "OUTLINE_FLOATS": 12,
    "PRIMITIVE_SUM_FLOATS": 32,  # a primitive's row of sums in the backward pass
    "COUNTER_INTS": 4,
    # tracer
    "LEAF_SURFELS": 4,
    "SURFEL_FLOATS": 12,
    "CENTER_STATISTIC_INTS": 13,
    "PACKET_RAYS": 8,
    "PAGE_ROWS": 32,  # hits a ray that a page holds
    # sort
    "DIGITS": 256,
    "KEYS_PER_BLOCK": 4096,
    # structural similarity
    "SSIM_TILE_WIDTH": 32,  # pixels
    "SSIM_TILE_HEIGHT": 16,  # pixels
}


def visible_floats(scale_columns: int, extras: int, color_alone: bool) -> int:
    """Floats of a visible primitive: its color, normal and extras, or its color alone, and its splat."""
    splat, color, normal = {2: 18, 3: 9}[scale_columns], 3, 3
    return _padded(splat + color if color_alone else splat + color + normal + max(extras, 1))


def appearance_floats(sh_coefficients: int, extras: int) -> int:
    """Floats that the tracer reads of a surfel that a ray hits, besides its geometry."""
    return _padded(3 * sh_coefficients + extras)


def color_floats(sh_coefficients: int) -> int:
    """The same where color is drawn alone, of halves: two in the place of a float."""
    return _padded(-(-3 * sh_coefficients // 2))


def trace_sum_floats(sh_coefficients: int, extras: int) -> int:
    """Floats of a surfel's row of sums in the tracer's backward pass."""
    moments, normal, opacity, color_direction = 12, 3, 1, 3
    return _padded(moments + normal + opacity + color_direction + 3 * sh_coefficients + extras)


def _padded(floats: int) -> int:
    """Rows begin at 16 bytes."""
    return -(-floats // 4) * 4
