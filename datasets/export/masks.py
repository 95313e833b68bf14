"""Mask files: masks of a scene's views, written as the folder beside the images that its source reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..errors import DatasetError
from ..formats.names import stem_of
from ..photographs.undistortion import Mask, distorted
from ..registry import own_settings, source_of


def write_masks(settings: Mapping[str, Any], cache_dir: Path, masks: Mapping[str, Mask], folder: Path) -> list[Path]:
    """Write one mask [H, W] a view, by the view's name, to `folder`; the files: PNG, white inside.

    A file has the path of its view's photograph. Where that is a pinhole's, it is the mask as given; where it is
    distorted, the mask is distorted likewise, so that undistorting it gives it back but for its edges. Of a scene
    without photographs it is <view>.png.

    Args:
        settings: the scene's, as for `load_scene`.

    Raises:
        DatasetError: a view has no photograph in the scene's files (any more).
    """
    of_source = source_of(settings["kind"]).photographs_of
    photographs = of_source(own_settings(settings), cache_dir) if of_source else []
    known = {photograph.view_name: photograph for photograph in photographs}
    lost = sorted(set(masks) - set(known)) if known else []
    if lost:
        raise DatasetError(f"{settings.get('root')}: has no photograph of view {lost[0]}; its files have changed")
    paths = []
    for name, mask in masks.items():
        path = folder / f"{name}.png"
        if known:
            path = folder / f"{stem_of(known[name].name)}.png"
            mask = distorted(mask, known[name].camera)
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(path)
        paths.append(path)
    return paths
