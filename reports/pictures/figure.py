"""A figure for a page: two test views as every method drew them, and below each a crop of them, pixel by pixel."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from envgs_bench.run_folder import read_png_if_any

from ..numbers.runs import read_runs
from ..tables.sections import split_sections
from .gallery import Gallery, Shot, galleries
from .sheets import CELL, MAX_COLUMNS, ZOOM, Panel, draw_grid, framed, weight_of, zoom_window

VIEWS = 2  # the worst and the median, or the next worse where these are one
MOST_BYTES = 190_000  # of the file: a page shows several
QUALITIES = range(92, 39, -4)  # of JPEG and WebP, the best that fits is taken
FORMATS = {".webp": "WEBP", ".jpg": "JPEG", ".jpeg": "JPEG"}


class FigureError(ValueError):
    """A figure that cannot be drawn; the message says what was found and what to choose."""


def draw_figure(runs: Path, path: Path, only: Sequence[str] = (), exclude: Sequence[str] = ()) -> Gallery:
    """Write the figure of one data set's runs: its worst and its median test view, ground truth first.

    Args:
        path: .webp or .jpg. Its quality is the best within MOST_BYTES.
        only, exclude: patterns of runs, see `read_runs`.

    Raises:
        FigureError: the runs are of several data sets or devices, or left no pictures, or the file's name has another
            ending.
        RecordError: `runs` is no folder.
    """
    if path.suffix.lower() not in FORMATS:
        raise FigureError(f"--figure {path}: expected a name that ends in {', '.join(FORMATS)}")
    gallery = _gallery(runs, only, exclude)
    shots = sorted(gallery.shots, key=lambda shot: not shot.roles)[:VIEWS]
    methods = list(gallery.methods)[:MAX_COLUMNS]
    lines, aspect = [], 0.0
    for shot in shots:
        target = read_png_if_any(shot.target)
        pictures = {m: read_png_if_any(shot.renders[m]) for m in methods if m in shot.renders}
        drawn = {m: picture for m, picture in pictures.items() if picture is not None}
        if target is None or not drawn or {picture.shape for picture in drawn.values()} != {target.shape}:
            raise FigureError(
                f"{runs}: view {shot.view}: a picture cannot be read, or has another size than the others"
            )
        aspect = aspect or target.shape[0] / target.shape[1]
        lines += _lines(shot, target, drawn, methods)
    sheet = draw_grid(["ground truth", *methods], [""] * (1 + len(methods)), lines, aspect)
    path.write_bytes(_encoded(sheet, FORMATS[path.suffix.lower()]))
    return gallery


def _gallery(runs: Path, only: Sequence[str], exclude: Sequence[str]) -> Gallery:
    """Of the runs' one data set."""
    found = [gallery for section in split_sections(read_runs(runs, only, exclude)[0]) for gallery in galleries(section)]
    if len(found) != 1:
        names = ", ".join(sorted({gallery.dataset for gallery in found})) or "none"
        raise FigureError(
            f"{runs}: a figure is of one data set, one protocol and one device; found {len(found)} that left pictures "
            f"({names}): choose with --only and --exclude"
        )
    return found[0]


def _lines(
    shot: Shot, target: np.ndarray, drawn: dict[str, np.ndarray], methods: Sequence[str]
) -> list[tuple[str, list[Panel]]]:
    """The whole pictures with the window's frame, and the window."""
    height, width = target.shape[:2]
    enlarged = max(1, round(CELL * ZOOM / width))  # a pixel of the window covers so many of the figure, either way
    size = (min(height, round(CELL * height / width / enlarged)), min(width, CELL // enlarged))
    errors = [np.abs(picture / 255.0 - target / 255.0).mean(-1) for picture in drawn.values()]
    window = zoom_window(errors, weight_of(shot, (height, width)), size)

    def line(first: Panel, of: dict[str, Panel]) -> list[Panel]:
        return [first, *(of.get(method, (None, "no picture")) for method in methods)]

    scores = {m: f"{shot.psnr[m]:.2f} dB" if m in shot.psnr else "" for m in drawn}
    whole: dict[str, Panel] = {m: (framed(picture, *window), scores[m]) for m, picture in drawn.items()}
    crops: dict[str, Panel] = {m: (picture[window], "") for m, picture in drawn.items()}
    return [("", line((framed(target, *window), ""), whole)), ("", line((target[window], ""), crops))]


def _encoded(sheet: Image.Image, kind: str) -> bytes:
    """The sheet in the best quality that fits; in the least where none does."""
    content = b""
    for quality in QUALITIES:
        stream = io.BytesIO()
        sheet.save(stream, kind, quality=quality, **({"method": 6} if kind == "WEBP" else {"optimize": True}))
        content = stream.getvalue()
        if len(content) <= MOST_BYTES:
            break
    return content
