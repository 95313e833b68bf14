"""FLIP's error maps, beside the renders that they judge."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import flip_evaluator
import numpy as np
from PIL import Image

from envgs_bench.run_folder import read_png_if_any

from .gallery import Gallery, Shot

MAX_PIXELS = 40_000_000  # in the maps of a data set, without those of the worst and the median view


def draw_error_maps(gallery: Gallery, out: Path) -> None:
    """Write <render>-flip.png beside the gallery's copied renders: of the worst and the median view, then of the others
    as far as MAX_PIXELS reach."""
    jobs, pixels = [], 0
    for shot in sorted(gallery.shots, key=lambda shot: not shot.roles):
        target = read_png_if_any(shot.target)
        if target is None or (pixels > MAX_PIXELS and not shot.roles):
            continue
        pixels += target[..., 0].size * len(shot.renders)
        jobs += [(shot, method, target) for method in shot.renders]

    def draw(job: tuple[Shot, str, np.ndarray]) -> None:
        shot, method, target = job
        render = read_png_if_any(shot.renders[method])
        if render is not None and render.shape == target.shape:
            name = gallery.files[shot.renders[method]].removesuffix(".png") + "-flip.png"
            Image.fromarray((colored_flip_map(render, target)[0] * 255 + 0.5).astype(np.uint8)).save(out / name)
            gallery.flips[shot.view, method] = {"flip": name}

    with ThreadPoolExecutor() as pool:  # the evaluator lets other threads run
        list(pool.map(draw, jobs))


def colored_flip_map(render: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
    """FLIP's error map in its own colors, [H, W, 3] in [0, 1], and its mean. Pictures are [H, W, 3] uint8, sRGB."""
    reference, test = (np.ascontiguousarray(picture, dtype=np.float32) / 255 for picture in (target, render))
    colors, mean, _ = flip_evaluator.evaluate(reference, test, "LDR")
    return colors, float(mean)
