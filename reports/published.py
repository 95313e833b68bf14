"""The numbers that the EnvGS paper printed, as data: what ours are set beside."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal
from functools import cache
from importlib.resources import files

import pandas as pd

from .decimals import mean

PUBLISHED_METRICS = ("psnr", "ssim", "lpips")
SCENE_TABLES = ("3", "7", "8", "9")  # the tables with a column a scene
PROTOCOL = "envgs"  # the protocol whose numbers compare with the paper's
FAMILY_NAMES = {
    "refreal": "Ref-Real",
    "nerfcasting": "NeRF-Casting",
    "shinyblender": "Shiny-Blender",
    "mipnerf360": "Mip-NeRF-360",
    "selfcaptured": "self-captured",
}
SCENE_NAMES = {"gardenspheres": "spheres"}
METHOD_NAMES = {"3dgs": "3DGS", "2dgs": "2DGS", "envgs": "EnvGS"}

Scene = tuple[str, str]  # the paper's data set and scene


@cache
def paper_tables() -> pd.DataFrame:
    """table, dataset, scene, region, method, group, metric, value, note: text as printed, "" where not readable."""
    with (files(__package__) / "paper_tables.csv").open(encoding="utf-8") as stream:
        return pd.read_csv(stream, dtype=str, keep_default_na=False)


@cache
def published_scores() -> dict[Scene, dict[str, dict[str, Decimal]]]:
    """Scene -> method -> metric -> value over the full image, methods in the paper's order; unreadable cells absent."""
    scores: dict[Scene, dict[str, dict[str, Decimal]]] = {}
    rows = paper_tables()
    rows = rows[rows["table"].isin(SCENE_TABLES) & (rows["value"] != "")]
    for dataset, scene, method, metric, value in rows[["dataset", "scene", "method", "metric", "value"]].to_numpy():
        scores.setdefault((dataset, scene), {}).setdefault(method, {})[metric] = Decimal(value)
    return scores


def paper_scene(dataset: str) -> Scene | None:
    """The paper's scene that a data set's name means: its family and its scene, however written ("Ref-Real/sedan",
    "ref_real-sedan"). A scene's name alone could be anybody's and matches nothing."""
    plain = _plain(dataset)
    for family, name in FAMILY_NAMES.items():
        if plain.startswith(family):
            scene = plain.removeprefix(family)
            found = (name, SCENE_NAMES.get(scene, scene))
            return found if found in published_scores() else None
    return None


def paper_method(method: str) -> str:
    """The paper's name of one of our methods, or the name itself."""
    return METHOD_NAMES.get(method, method)


def published_means(datasets: Sequence[str], metric: str) -> dict[str, Decimal]:
    """The paper's methods with their unrounded mean over the data sets, those alone that have a value for each.

    Empty where one of the data sets is not of the paper.
    """
    scenes = [paper_scene(dataset) for dataset in datasets]
    found = [published_scores()[scene] for scene in scenes if scene is not None]
    if not found or len(found) < len(scenes):
        return {}
    return {
        method: mean(scores[method][metric] for scores in found)
        for method in found[0]
        if all(metric in scores.get(method, {}) for scores in found)
    }


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
