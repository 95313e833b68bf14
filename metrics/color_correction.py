"""Color correction: the one affine map of color that brings a picture nearest to its photograph.

A camera's exposure and white balance change from view to view, and no method can know those of a photograph that it
has not seen. Scores after the correction leave that out; a tint or a veil of the method's own they forgive as well.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def color_corrected(prediction: Tensor, target: Tensor) -> Tensor:
    """The prediction's colors c as A c + b, A [3, 3] and b [3] the least-squares ones over all pixels, clamped.

    Where several maps are as near, as for a picture of one color, the smallest is taken.

    Args:
        prediction, target: [H, W, 3] floats, sRGB, finite.

    Returns:
        [H, W, 3] in [0, 1], of the prediction's dtype and on its device.
    """
    colors, wanted = (image.detach().cpu().double().reshape(-1, 3) for image in (prediction, target))
    with_one = functional.pad(colors, (0, 1), value=1.0)
    found = torch.linalg.lstsq(with_one, wanted, driver="gelsd").solution  # [4, 3]; for any rank, on CPUs alone
    return (with_one @ found).clamp(0, 1).reshape(prediction.shape).to(prediction)
