"""Renders: test views that another program drew, a folder of pictures, matched to the views and scored as any other."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.formats.arrays import open_array
from envgs_bench.datasets.formats.names import composed
from envgs_bench.datasets.formats.pictures import read_header, read_picture
from envgs_bench.methods.settings import make_settings
from envgs_bench.metrics import Protocol
from envgs_bench.records import MaskedScores, Metrics
from envgs_bench.settings import RunSettings

from .evaluation import scored_views
from .events import EventListener
from .loading import check_scene, load_for_run
from .pictures import save_pair
from .predictions import rendered_folder
from .render_files import RendersSettings, rendered_files
from .results import Results
from .scoring import Pair, score_pairs

MODES = ("L", "LA", "P", "RGB", "RGBA")  # those of 8 bits a channel
WHOLE = "whole"
CROPS = (WHOLE, "left half", "right half")  # the parts of a file that may be the picture
IN_ORDER = (
    "method.settings.match=order takes numbered files in the views' order, as does pictures.match: order of a recipe"
)
MAX_LISTED = 20  # problems listed of each kind
MAX_MEAN = 1.5  # mean of a picture whose range is [0, 1], with room for what overshoots


class RendersError(ValueError):
    """The folder does not fit the test views; the message lists all that does not."""


def run_renders(
    settings: RunSettings, folder: Path, results: Results, protocol: Protocol, report: EventListener
) -> None:
    """The run of a method whose pictures lie in a folder: nothing is trained, drawn or timed."""
    results.steps = 0
    scene = load_for_run(settings, results, report)
    check_scene(scene)
    views, background = scored_views(scene, settings.score_on), scene.background
    scored = score_renders(settings.method.settings, views, background, protocol, folder, report, settings.device)
    results.metrics, results.masked = scored


def score_renders(
    settings: Mapping[str, Any],
    views: Sequence[View],
    background: Tensor,
    protocol: Protocol,
    folder: Path,
    report: EventListener,
    device: str,
) -> tuple[Metrics, dict[str, MaskedScores]]:
    """Scores, made on `device`, of the pictures that `settings` name as `views`; a copy of each is left in `folder`.

    Raises:
        ValueError: an unknown setting.
        RendersError: files or views are left over, or a file cannot be taken for its view.
    """
    choice = make_settings(RendersSettings, settings, "method renders: ")
    with rendered_folder(Path(choice.path)) as renders:
        files = match_renders(renders, choice.match, views)

        def pairs() -> Iterator[Pair]:
            for number, view in enumerate(views):
                report({"stage": "scoring", "step": number, "steps": len(views)})
                image = read_render(files[view.name], background)
                save_pair(folder, view, image, {})
                yield Pair(view.name, image, view.rgb(), view.masks)

        return score_pairs(pairs(), protocol, device)


def match_renders(
    folder: Path, match: str, views: Sequence[View], files: Sequence[Path] | None = None, crop: str = WHOLE
) -> dict[str, Path]:
    """The file of each view, by the view's name.

    Args:
        files: those of the folder that are meant; all `rendered_files` where None.
        crop: the part of each that is the picture, one of CROPS.
        match: "name": a file is called after its view (`a/b.png` is view a_b); "order": sorted by their numbers, the
            files are the views in the order of their names.

    Raises:
        RendersError: naming every view without a file, every file without a view and every file of another size.
    """
    if match not in ("name", "order"):
        raise RendersError(f"match={match}: expected name or order")
    if not folder.is_dir():
        raise RendersError(f"{folder}: there is no such folder; give that of the renders as path=…")
    files = sorted(rendered_files(folder) if files is None else files, key=_natural)
    names = [view.name for view in views]
    problems: dict[str, list[str]] = {}
    if match == "order":
        found = dict(zip(names, files, strict=False))
        problems["views without a file"] = names[len(files) :]
        problems["files without a view"] = [str(path.relative_to(folder)) for path in files[len(names) :]]
    else:
        found = {}
        for path in files:
            name = composed(path.relative_to(folder).with_suffix("").as_posix().replace("/", "_"))
            if name in found or name not in names:
                kind = "files of a view that another file is for" if name in found else "files without a view"
                problems.setdefault(kind, []).append(str(path.relative_to(folder)))
            else:
                found[name] = path
        problems["views without a file"] = [name for name in names if name not in found]
    problems["files that are not their view's"] = [
        f"{found[view.name].relative_to(folder)}: {problem}"
        for view in views
        if view.name in found and (problem := _misfit(found[view.name], view, crop))
    ]
    if any(problems.values()):
        listed = "\n".join(f"  {len(items)} {kind}: {_listed(items)}" for kind, items in problems.items() if items)
        raise RendersError(
            f"{folder}: does not fit the {len(views)} test views:\n{listed}\n"
            f"Expected one picture a test view, <view>.png, .jpg or .npy, of the view's size"
            + (f", {crop} of the file" if crop != WHOLE else "")
            + (f"; {IN_ORDER}" if match == "name" else "")
        )
    return found


def read_render(path: Path, background: Tensor, crop: str = WHOLE) -> Tensor:
    """The picture as floats [H, W, 3], sRGB: bytes / 255, laid on `background` where transparent; an array as it is.

    Args:
        crop: the part of the file that is the picture, one of CROPS.

    Raises:
        RendersError: it cannot be decoded, a value is not finite, or the values cannot be meant to lie in [0, 1].
    """
    try:
        if path.suffix.lower() == ".npy":
            values: NDArray[Any] = open_array(path)
            scale = 255 if values.dtype == np.uint8 else 1
        else:
            red, green, blue = background.tolist()
            values, scale = read_picture(path, (red, green, blue))[0], 255
    except DatasetError as error:
        raise RendersError(str(error)) from error
    image = torch.from_numpy(np.array(values, np.float32)) / scale
    if not torch.isfinite(image).all():
        raise RendersError(f"{path}: {float((~torch.isfinite(image)).float().mean()):.1%} of its values are not finite")
    if image.abs().mean() > MAX_MEAN:
        raise RendersError(
            f"{path}: its values average {float(image.mean()):.3g}, expected sRGB in [0, 1]; divide by 255?"
        )
    middle = image.shape[1] // 2
    return {WHOLE: image, "left half": image[:, :middle], "right half": image[:, middle:]}[crop]


def _misfit(path: Path, view: View, crop: str) -> str | None:
    """Why the file cannot be the view's picture, from its header alone; None where it can."""
    expected = (view.camera.height, view.camera.width * (1 if crop == WHOLE else 2), 3)
    try:
        if path.suffix.lower() == ".npy":
            array = open_array(path)
            if array.dtype != np.uint8 and not np.issubdtype(array.dtype, np.floating):
                return f"holds {array.dtype}, expected floats in [0, 1] or bytes"
            shape: tuple[int, ...] = array.shape
            if len(shape) != 3 or shape[2] != 3:
                return f"has shape {shape}, expected {expected}"
        else:
            header = read_header(path)
            if header.mode not in MODES:
                return f"has pixels of mode {header.mode}, expected 8 bits a channel"
            shape = (header.height, header.width, 3)
    except DatasetError as error:
        return f"cannot be read ({error})"
    if shape == expected:
        return None
    wanted = f"{view.camera.width}×{view.camera.height}" + ("" if crop == WHOLE else f", which is the {crop} of a file")
    return f"is {shape[1]}×{shape[0]} pixels, its view {wanted}"


def _natural(path: Path) -> list[Any]:
    """Sort key that has 9.png before 10.png."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.as_posix())]


def _listed(items: Sequence[str]) -> str:
    more = len(items) - MAX_LISTED
    return ", ".join(items[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
