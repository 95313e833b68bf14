"""Views as files: pictures, masks and normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from envgs_bench.core import View

from ..progress import mapped


@dataclass(frozen=True)
class ViewFiles:
    """A view and where its files go: paths below the export's folder, without extension."""

    view: View
    image: str
    mask: str  # below each region's folder
    normal: str  # written where the view has normals


def write_views(root: Path, views: Sequence[ViewFiles]) -> None:
    """RGB PNGs with the pictures' bytes as they are, masks and normals, in parallel.

    Masks lie in masks/ for the region `foreground` and in masks_<region>/ for others, white inside. A folder is
    complete: where a view lacks a region, its mask is black, which scores nothing, as before; a region that is empty
    in all has none. Normals are float32 [H, W, 3] `.npy`, world frame: eight bits would cost a fifth of a degree.
    """
    regions = sorted({region for files in views for region, mask in files.view.masks.items() if mask.any()})

    def write(files: ViewFiles) -> None:
        view = files.view
        _write_png(root / f"{files.image}.png", view.image)
        for region in regions:
            folder = root / ("masks" if region == "foreground" else f"masks_{region}")
            mask = view.masks.get(region, torch.zeros(view.image.shape[:2], dtype=torch.bool))
            _write_png(folder / f"{files.mask}.png", 255 * mask.to(torch.uint8))
        if view.normal is not None:
            path = root / f"{files.normal}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, view.normal.float().numpy())

    mapped("writing views", write, views)


def _write_png(path: Path, pixels: Tensor) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels.numpy()).save(path, compress_level=3)
