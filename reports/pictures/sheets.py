"""Sheets: one picture of a test view as every method drew it, with a zoom into reflections and its error maps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import uniform_filter

from envgs_bench.parts import BETA
from envgs_bench.run_folder import read_png_if_any

from .gallery import Gallery, Shot, ordered_layers, slug

CELL = 340  # width of a picture in a sheet, px
MARGIN, GAP, HEAD, MAX_SIDE = 26, 14, 44, 300
MAX_COLUMNS = 7  # methods in one sheet
ZOOM = 3.2  # the zoomed window is this fraction of the picture's edges
INK, SOFT, FRAME, PAPER = "#1f2733", "#667085", "#ffd400", "#ffffff"
Panel = tuple[np.ndarray | None, str]  # the picture and its score, or the words in its place
NORMAL = "normal"


def draw_sheets(gallery: Gallery, out: Path, folder: str) -> dict[str, str]:
    """Write a sheet for the worst and for the median view, and one of their layers; title -> path within `out`."""
    written: dict[str, str] = {}
    for shot in gallery.shots:
        if not shot.roles:
            continue
        stem = f"{folder}/{'-'.join(shot.roles)}-{slug(shot.view)}"
        _save(_comparison(gallery, shot, out), out / f"{stem}.png")
        written[f"{shot.title}: all methods"] = f"{stem}.png"
        if shot.layers:
            _save(_layer_sheet(shot), out / f"{stem}-layers.png")
            written[f"{shot.title}: layers"] = f"{stem}-layers.png"
    return written


def draw_headline(shot: Shot, methods: Sequence[str], path: Path) -> bool:
    """Write the window of a view where the methods differ most; False where one of the pictures is not readable."""
    pictures = [read_png_if_any(file) for file in (shot.target, *(shot.renders[method] for method in methods))]
    drawn = [picture for picture in pictures if picture is not None]
    if len({picture.shape for picture in drawn}) != 1 or len(drawn) < len(pictures):
        return False
    target = drawn[0]
    errors = [np.abs(picture / 255.0 - target / 255.0).mean(-1) for picture in drawn[1:]]
    window = zoom_window(errors, weight_of(shot, target.shape[:2]))
    notes = ["", *(f"{shot.psnr[method]:.2f} dB" if method in shot.psnr else "" for method in methods)]
    lines: list[tuple[str, list[Panel]]] = [
        ("", [(framed(picture, *window), "") for picture in drawn]),
        ("", [(picture[window], "") for picture in drawn]),
    ]
    _save(draw_grid(["ground truth", *methods], notes, lines, target.shape[0] / target.shape[1]), path)
    return True


def zoom_window(
    errors: Sequence[np.ndarray], weight: np.ndarray, size: tuple[int, int] | None = None
) -> tuple[slice, slice]:
    """Rows and columns where the methods differ most.

    Args:
        errors: [H, W] of each method.
        weight: [H, W] ≥ 0, where to look: the reflective region.
        size: of the window, rows and columns, px; otherwise 1 / ZOOM of the edges.
    """
    height, width = weight.shape
    rows, columns = size or (max(1, round(height / ZOOM)), max(1, round(width / ZOOM)))
    difference = np.std(errors, axis=0) if len(errors) > 1 else errors[0]
    score = uniform_filter(difference * weight, size=(rows, columns), mode="constant")
    inner = score[rows // 2 : height - (rows - 1) // 2, columns // 2 : width - (columns - 1) // 2]
    top, left = np.unravel_index(int(np.argmax(inner)), inner.shape)
    return slice(int(top), int(top) + rows), slice(int(left), int(left) + columns)


def _comparison(gallery: Gallery, shot: Shot, out: Path) -> Image.Image:
    target = read_png_if_any(shot.target)
    if target is None:
        return draw_grid(["ground truth"], [""], [("", [(None, "not readable")])], 0.75)
    methods = [method for method in gallery.methods if method in shot.renders][:MAX_COLUMNS]
    renders = {method: read_png_if_any(shot.renders[method]) for method in methods}
    fitting = {m: picture for m, picture in renders.items() if picture is not None and picture.shape == target.shape}
    rows, columns = slice(0, target.shape[0]), slice(0, target.shape[1])
    if fitting:
        errors = [np.abs(picture / 255.0 - target / 255.0).mean(-1) for picture in fitting.values()]
        rows, columns = zoom_window(errors, weight_of(shot, target.shape[:2]))
    maps = {m: read_png_if_any(out / flip["flip"]) for m in fitting if (flip := gallery.flips.get((shot.view, m)))}
    notes = ["", *(f"{shot.psnr[m]:.2f} dB" if m in shot.psnr else "" for m in methods)]
    failed = list(gallery.missing)[: MAX_COLUMNS - len(methods)]

    def line(first: Panel, of: Callable[[str], np.ndarray | None]) -> list[Panel]:
        drawn = [(of(method), "") if method in fitting else (None, "not readable") for method in methods]
        return [first, *drawn, *((None, gallery.missing[method]) for method in failed)]

    whole = line((framed(target, rows, columns), ""), lambda m: framed(fitting[m], rows, columns))
    zoomed = line((target[rows, columns], ""), lambda m: fitting[m][rows, columns])
    flips = line((None, "FLIP error map\nblack 0, white 1"), lambda m: maps.get(m))
    titles = ["ground truth", *methods, *failed]
    lines = [("", whole), ("zoom", zoomed), ("FLIP", flips)]
    return draw_grid(titles, notes + [""] * len(failed), lines, target.shape[0] / target.shape[1])


def _layer_sheet(shot: Shot) -> Image.Image:
    """A line a method; above them the ground truth, as far as it is known."""
    names = ordered_layers({name for layers in shot.layers.values() for name in layers})
    exact = read_png_if_any(shot.normal) if shot.normal is not None else None
    truth = [(exact, "") if name == NORMAL and exact is not None else (None, "") for name in names]
    target = read_png_if_any(shot.target)
    lines: list[tuple[str, list[Panel]]] = [("ground truth", [(target, ""), *truth])]
    shape = target.shape if target is not None else None
    for method in list(shot.layers)[:MAX_COLUMNS]:
        pictures = [read_png_if_any(shot.renders[method])]
        pictures += [read_png_if_any(path) if (path := shot.layers[method].get(n)) else None for n in names]
        shape = shape or next((picture.shape for picture in pictures if picture is not None), None)
        words = [f"{shot.psnr[method]:.2f} dB" if method in shot.psnr else ""]
        words += [f"{shot.degrees[method]:.1f}°" if name == NORMAL and method in shot.degrees else "" for name in names]
        lines.append((method, [(p, "none" if p is None else w) for p, w in zip(pictures, words, strict=True)]))
    titles = ["render", *("β" if name == BETA else name for name in names)]
    return draw_grid(titles, [""] * len(titles), lines, shape[0] / shape[1] if shape else 0.75)


def weight_of(shot: Shot, shape: tuple[int, int]) -> np.ndarray:
    """Where the scene reflects: its mask, or else the β of the last method that has one, or else everywhere."""
    betas = [layers[BETA] for layers in shot.layers.values() if BETA in layers]
    for path in filter(None, (shot.mask, *betas[-1:])):
        picture = read_png_if_any(path)
        if picture is not None and picture.shape[:2] == shape and picture.any():
            return picture[..., 0] / 255.0
    return np.ones(shape)


def framed(picture: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
    """The picture with a frame around the window."""
    framed = Image.fromarray(picture)
    width = max(1, round(picture.shape[1] / CELL * 2))
    corners = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
    ImageDraw.Draw(framed).rectangle(corners, outline=FRAME, width=width)
    return np.asarray(framed)


def draw_grid(titles: list[str], notes: list[str], lines: list[tuple[str, list[Panel]]], aspect: float) -> Image.Image:
    """A sheet: a title and a note above each column, a name beside each row."""
    height = round(CELL * aspect)
    longest = max((_font(17, True).getlength(name) for name, _ in lines), default=0.0)
    side = min(MAX_SIDE, math.ceil(longest) + GAP) if longest else 0
    size = (2 * MARGIN + side + len(titles) * (CELL + GAP) - GAP, 2 * MARGIN + HEAD + len(lines) * (height + GAP) - GAP)
    sheet = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(sheet)
    for column, (title, note) in enumerate(zip(titles, notes, strict=True)):
        x = MARGIN + side + column * (CELL + GAP)
        draw.text((x, MARGIN), _fitted(title, CELL - (116 if note else 0), 21, True), INK, _font(21, True))
        draw.text((x + CELL, MARGIN + 2), note, SOFT, _font(18), anchor="ra")
    for row, (name, panels) in enumerate(lines):
        y = MARGIN + HEAD + row * (height + GAP)
        draw.text((MARGIN, y + height / 2), _fitted(name, side - GAP, 17, True), INK, _font(17, True), anchor="lm")
        for column, (picture, words) in enumerate(panels):
            x = MARGIN + side + column * (CELL + GAP)
            if picture is None:
                draw.rectangle((x, y, x + CELL - 1, y + height - 1), fill="#f3f5f9")
                draw.text((x + CELL / 2, y + height / 2), words, SOFT, _font(18), anchor="mm", align="center")
            else:
                sheet.paste(_scaled(picture, (CELL, height)), (x, y))
                if words:
                    box = draw.textbbox((x + 8, y + height - 8), words, _font(18, True), anchor="lb")
                    draw.rectangle((box[0] - 5, box[1] - 4, box[2] + 5, box[3] + 4), fill=INK)
                    draw.text((x + 8, y + height - 8), words, PAPER, _font(18, True), anchor="lb")
    return sheet


def _scaled(picture: np.ndarray, size: tuple[int, int]) -> Image.Image:
    """Enlarged by whole pixels, so that nothing is made up; reduced smoothly."""
    pixels = picture if picture.dtype == np.uint8 else (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
    larger = size[0] >= pixels.shape[1]
    return Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST if larger else Image.Resampling.LANCZOS)


def _fitted(text: str, width: float, size: int, bold: bool) -> str:
    """The text, shortened with an ellipsis to `width` pixels."""
    if _font(size, bold).getlength(text) <= width:
        return text
    while text and _font(size, bold).getlength(text + "…") > width:
        text = text[:-1]
    return text + "…"


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings along: the same on every machine."""
    return ImageFont.truetype(Path(mpl.get_data_path()) / "fonts/ttf" / f"DejaVuSans{'-Bold' * bold}.ttf", size)


def _save(sheet: Image.Image, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
