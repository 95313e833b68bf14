"""Sheets: several pictures as one, each with its name in a corner."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .opened import Picture

TEXT_SHARE = 0.035  # a name's height, of the picture's
LEAST_TEXT = 10  # pixels


def side_by_side(pictures: Mapping[str, Picture]) -> Picture:
    """The pictures, all [H, W, 3], from left to right with their names; a single one as it is."""
    if len(pictures) == 1:
        return next(iter(pictures.values()))
    return np.concatenate([named(picture, name) for name, picture in pictures.items()], axis=1)


def named(picture: Picture, name: str, *, right: bool = False, bottom: bool = False) -> Picture:
    """A copy of the picture with `name` in a corner, the upper left one by default: white on black."""
    image = Image.fromarray(picture)
    draw, height, width = ImageDraw.Draw(image), *picture.shape[:2]
    size = max(LEAST_TEXT, round(TEXT_SHARE * height))
    font = ImageFont.load_default(size)
    room = draw.textlength(name, font) + size
    left, top = max(0, width - room) if right else 0, height - 1.5 * size if bottom else 0
    draw.rectangle((left, top, left + room, top + 1.5 * size), fill=(0, 0, 0))
    draw.text((left + size / 2, top + 0.1 * size), name, fill=(255, 255, 255), font=font)
    return np.asarray(image)
