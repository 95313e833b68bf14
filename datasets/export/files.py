"""A view's pictures as files: PNGs, masks and normals."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from envgs_bench.core import View


def write_image(path: Path, view: View) -> None:
    """The picture as RGB PNG, its bytes as they are."""
    _write_png(path, view.image.numpy())


def write_masks(root: Path, views: Iterable[View], name_of: dict[str, str]) -> None:
    """Regions as folders beside the images: masks/ for `foreground`, masks_<region>/ for others, white inside.

    A folder is complete; where a view lacks a region, its mask is black, which scores nothing, as before.

    Args:
        name_of: file names below a region's folder, without extension, by the views' names.
    """
    ordered = list(views)
    for region in sorted({region for view in ordered for region in view.masks}):
        folder = root / ("masks" if region == "foreground" else f"masks_{region}")
        for view in ordered:
            mask = view.masks.get(region, torch.zeros(view.image.shape[:2], dtype=torch.bool))
            _write_png(folder / f"{name_of[view.name]}.png", np.where(mask.numpy(), 255, 0).astype(np.uint8))


def write_normals(path: Path, normal: Tensor) -> None:
    """Normals as float32 [H, W, 3] `.npy`, world frame: eight bits would cost a fifth of a degree."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, normal.float().numpy())


def _write_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, compress_level=3)
