"""The numbers that the EnvGS paper printed, as data: what ours are set beside."""

from __future__ import annotations

import re
from decimal import Decimal
from functools import cache
from importlib.resources import files
from typing import Literal

import pandas as pd

from .decimals import mean
from .settings import as_number

PROTOCOL = "envgs"  # the protocol whose numbers compare with the paper's
FAMILY_NAMES = {
    "refreal": "Ref-Real",
    "nerfcasting": "NeRF-Casting",
    "shinyblender": "Shiny-Blender",
    "mipnerf360": "Mip-NeRF-360",
    "selfcaptured": "self-captured",
    "envgs": "self-captured",
}
SCENE_NAMES = {"gardenspheres": "spheres"}
METHOD_NAMES = {
    "3dgs": "3DGS",
    "2dgs": "2DGS",
    "envgs_paper": "EnvGS",
    "envmap_paper": "w/ environment map",
    "envgs_paper_no_joint": "w/o joint optimization",
    "envgs_paper_no_mono_normal": "w/o mono normal loss",
    "envgs_paper_no_color_sabotage": "w/o color sabotage",
    "envgs_paper_no_normal_propagation": "w/o normal propagation",
    "envgs_paper_no_perceptual": "w/o lpips loss",
    "envgs": "envgs",  # configured by this project: not the paper's, however alike the names
}
REGION_NAMES = {"reflective": "foreground"}  # the paper's foreground is what of it reflects (App. A.1)

Scene = tuple[str, str]  # the paper's data set and scene
Source = Literal["realtime", "non_realtime", "ablation"]  # the group of rows in which the paper prints a method


@cache
def paper_tables() -> pd.DataFrame:
    """table, dataset, scene, region, method, group, metric, value, note: text as printed, "" where not readable."""
    with (files(__package__) / "paper_tables.csv").open(encoding="utf-8") as stream:
        return pd.read_csv(stream, dtype=str, keep_default_na=False)


@cache
def _printed() -> dict[tuple[str, str, str, str], dict[str, Decimal]]:
    """(data set, scene or "mean", region, metric) -> method -> value, in the paper's order; unreadable cells absent."""
    printed: dict[tuple[str, str, str, str], dict[str, Decimal]] = {}
    columns = ["dataset", "scene", "region", "metric", "method", "value"]
    for *place, method, value in paper_tables()[columns].itertuples(index=False):
        if value:
            printed.setdefault(tuple(place), {})[method] = Decimal(value)
    return printed


@cache
def _scenes() -> dict[str, frozenset[str]]:
    """The scenes of each of the paper's data sets."""
    scenes: dict[str, set[str]] = {}
    for dataset, scene, _, _ in _printed():
        if scene != "mean":
            scenes.setdefault(dataset, set()).add(scene)
    return {dataset: frozenset(names) for dataset, names in scenes.items()}


@cache
def published_source(method: str) -> Source:
    """Where the paper prints the method."""
    rows = paper_tables()
    groups = rows.loc[rows["method"] == method, "group"].unique()
    return next(group for group in ("realtime", "non_realtime", "ablation") if group in groups)


def paper_scene(dataset: str) -> Scene | None:
    """The paper's scene that a data set's name means: its family and its scene, however written ("Ref-Real/sedan",
    "ref_real-sedan"). A scene's name alone could be anybody's and matches nothing."""
    plain = _plain(dataset)
    for family, name in FAMILY_NAMES.items():
        if plain.startswith(family):
            scene = plain.removeprefix(family)
            found = (name, SCENE_NAMES.get(scene, scene))
            return found if found[1] in _scenes()[name] else None
    return None


def paper_method(method: str) -> str:
    """The paper's name of one of our rows, or the row's own: its Table 6 is the turn of one knob of its EnvGS."""
    name, turned, text = method.partition(" [beta_filter=")
    share = as_number(text.removesuffix("]")) if turned else 0.0
    if share is None or (turned and METHOD_NAMES.get(name) != "EnvGS"):
        return method
    if share > 0:
        return f"w/ {100 * share:.0f}% weight filtering"
    return METHOD_NAMES.get(name, _spellings().get(_plain(name), name))


@cache
def _spellings() -> dict[str, str]:
    """The paper's methods by their names' letters and digits alone: "zip-nerf" is its ZipNeRF."""
    return {_plain(name): name for name in paper_tables()["method"].unique() if not name.endswith("*")}


@cache
def published_values(datasets: tuple[str, ...], region: str, metric: str) -> dict[str, Decimal]:
    """The paper's methods with their value for these data sets: as printed where the paper prints the mean over just
    these, else the unrounded mean of its scenes, of the methods that have a value for each.

    Empty where one of the data sets is not of the paper.
    """
    found = [paper_scene(dataset) for dataset in datasets]
    scenes = [scene for scene in found if scene is not None]
    if not scenes or len(scenes) < len(found):
        return {}
    region = REGION_NAMES.get(region, region)
    each = [_printed().get((*scene, region, metric), {}) for scene in scenes]
    means = {m: mean(scores[m] for scores in each) for m in each[0] if all(m in scores for scores in each)}
    return means | (_printed_mean(frozenset(scenes), region, metric) if len(scenes) > 1 else {})


def _printed_mean(scenes: frozenset[Scene], region: str, metric: str) -> dict[str, Decimal]:
    """What the paper prints as the mean over exactly these scenes."""
    for (dataset, scene, *kind), values in _printed().items():
        whole = frozenset((name, member) for name in dataset.split("+") for member in _scenes()[name])
        if scene == "mean" and kind == [region, metric] and whole == scenes:
            return values
    return {}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
