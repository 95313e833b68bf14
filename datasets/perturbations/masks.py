"""Region masks that are wrong by some pixels: no method sees them, scores inside regions do.

So these change the masks of the views that are scored, and of nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import Scene, View


def grow(scene: Scene, pixels: float, rng: object) -> Scene:
    """Every mask of a test or validation view dilated by so many pixels, along rows and columns."""
    from scipy import ndimage

    return _with_masks(scene, lambda mask: ndimage.binary_dilation(mask, iterations=int(pixels)))


def shrink(scene: Scene, pixels: float, rng: object) -> Scene:
    """Every mask of a test or validation view eroded by so many pixels; the picture's border erodes nothing."""
    from scipy import ndimage

    return _with_masks(scene, lambda mask: ndimage.binary_erosion(mask, iterations=int(pixels), border_value=1))


def _with_masks(scene: Scene, change: Callable[[np.ndarray], np.ndarray]) -> Scene:
    def changed(view: View) -> View:
        masks: dict[str, Tensor] = {
            region: torch.from_numpy(change(mask.numpy())) for region, mask in view.masks.items()
        }
        return replace(view, masks=masks)

    return replace(scene, test=[changed(view) for view in scene.test], val=[changed(view) for view in scene.val])
