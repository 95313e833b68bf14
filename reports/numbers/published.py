"""The numbers that others printed, as data: what ours of the same protocol are set beside.

Under the protocol `envgs` those of the EnvGS paper, if PRINTED_BY names no other. Under `nerfbaselines` those on
https://nerfbaselines.github.io, as of its commit e1c9749 of 2025-11-08.
"""

from __future__ import annotations

import re
from decimal import Decimal
from functools import cache
from importlib.resources import files
from typing import Literal

import pandas as pd

from envgs_bench.parts import MethodCard
from envgs_bench.records import ELSEWHERE

from .decimals import mean
from .settings import as_number

PROTOCOL = "envgs"  # the protocol whose numbers compare with the paper's
BENCHMARK = "nerfbaselines"  # the one whose numbers compare with that benchmark's
# A record's protocol -> that of the numbers beside it.
PROTOCOLS = {PROTOCOL: PROTOCOL, BENCHMARK: BENCHMARK, f"{BENCHMARK}-8bit": BENCHMARK}
PRINTED_BY = {  # other sources' data sets -> who printed their numbers
    "Ref-Real ÷8": "by the authors of Spherical Voronoi (2512.14180), who retrained the others; sedan at an eighth",
}
OTHER_SIZES = {"Ref-Real ÷8": ("Ref-Real", ("sedan",))}  # a family of others -> one of alike scenes, but for some
FAMILY_NAMES = {
    "refreal8": "Ref-Real ÷8",  # before the family whose name it begins with
    "refreal": "Ref-Real",
    "nerfcasting": "NeRF-Casting",
    "shinyblender": "Shiny-Blender",
    "mipnerf360": "Mip-NeRF-360",
    "selfcaptured": "self-captured",
    "envgs": "self-captured",
}
SCENE_NAMES = {"gardenspheres": "spheres"}
REGION_NAMES = {"reflective": "foreground"}  # the paper's foreground is what of it reflects (App. A.1)

Scene = tuple[str, str]  # the paper's data set and scene
Source = Literal["realtime", "non_realtime", "ablation"]  # the group of rows in which the paper prints a method
SOURCES: tuple[Source, ...] = ("realtime", "non_realtime", "ablation")


@cache
def paper_tables() -> pd.DataFrame:
    """table, dataset, scene, region, method, group, metric, value, note: text as printed, "" where not readable."""
    with (files(__package__) / "paper_tables.csv").open(encoding="utf-8") as stream:
        return pd.read_csv(stream, dtype=str, keep_default_na=False)


def _benchmark_tables() -> pd.DataFrame:
    """As `paper_tables`, without table, group and note."""
    with (files(__package__) / "nerfbaselines.csv").open(encoding="utf-8") as stream:
        wide = pd.read_csv(stream, dtype=str, keep_default_na=False)
    return wide.melt(["dataset", "scene", "method"], var_name="metric").assign(region="full")


@cache
def _printed(protocol: str = PROTOCOL) -> dict[tuple[str, str, str, str], dict[str, Decimal]]:
    """(data set, scene or "mean", region, metric) -> method -> value, in the printed order; no unreadable cells."""
    printed: dict[tuple[str, str, str, str], dict[str, Decimal]] = {}
    columns = ["dataset", "scene", "region", "metric", "method", "value"]
    tables = _benchmark_tables() if protocol == BENCHMARK else paper_tables()
    for *place, method, value in tables[columns].itertuples(index=False):
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


def printed_by(datasets: tuple[str, ...], protocol: str = PROTOCOL) -> str:
    """Who printed the numbers of these data sets, in words."""
    if PROTOCOLS[protocol] == BENCHMARK:
        return "by nerfbaselines (e1c9749), of released JPEGs of that size, where ours come from the photographs"
    families = {found[0] for found in map(paper_scene, datasets) if found is not None}
    return next((PRINTED_BY[family] for family in families if family in PRINTED_BY), "in the EnvGS paper")


@cache
def published_source(method: str) -> Source | None:
    """Where the paper prints the method; None where it does not."""
    rows = paper_tables()
    groups = rows.loc[rows["method"] == method, "group"].unique()
    return next((group for group in SOURCES if group in groups), None)


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


def paper_method(row: str, card: MethodCard, kind: str) -> str:
    """The paper's name of one of our rows, or the row's own.

    That is what the method's card says. A sweep of `beta_filter` is the paper's Table 6. Pictures from elsewhere need
    no card: their method's name, however written, is the paper's ("zip-nerf" is its ZipNeRF).
    """
    _, swept, text = row.partition(" [beta_filter=")
    if kind in ELSEWHERE:
        return _spellings().get(_plain(row), row)
    share = as_number(text.removesuffix("]")) if swept else 0.0
    if not card.published or share is None or (swept and published_source(card.published) == "ablation"):
        return row
    return f"w/ {100 * share:.0f}% weight filtering" if share > 0 else card.published


@cache
def _spellings() -> dict[str, str]:
    """The printed methods by their names' letters and digits alone."""
    names = (*_benchmark_tables()["method"].unique(), *paper_tables()["method"].unique())
    return {_plain(name): name for name in names if not name.endswith("*")}


@cache
def published_values(
    datasets: tuple[str, ...], region: str, metric: str, protocol: str = PROTOCOL
) -> dict[str, Decimal]:
    """The paper's methods with their value for these data sets: as printed where the paper prints the mean over just
    these, else the unrounded mean of its scenes, of the methods that have a value for each.

    Args:
        protocol: one of PROTOCOLS: whose numbers.

    Empty where one of the data sets is not of the paper.
    """
    found = [paper_scene(dataset) for dataset in datasets]
    scenes = [scene for scene in found if scene is not None]
    for family in {name for name, _ in scenes if name in OTHER_SIZES}:  # whose other scenes are those of the first
        first, own = OTHER_SIZES[family]
        scenes = [(family, scene) if name == first and scene not in own else (name, scene) for name, scene in scenes]
    if not scenes or len(scenes) < len(found):
        return {}
    region = REGION_NAMES.get(region, region)
    source = PROTOCOLS[protocol]
    each = [_printed(source).get((*scene, region, metric), {}) for scene in scenes]
    means = {m: mean(scores[m] for scores in each) for m in each[0] if all(m in scores for scores in each)}
    return means | (_printed_mean(frozenset(scenes), region, metric, source) if len(scenes) > 1 else {})


def _printed_mean(scenes: frozenset[Scene], region: str, metric: str, source: str) -> dict[str, Decimal]:
    """What the paper prints as the mean over exactly these scenes."""
    for (dataset, scene, *kind), values in _printed(source).items():
        whole = frozenset((name, member) for name in dataset.split("+") for member in _scenes()[name])
        if scene == "mean" and kind == [region, metric] and whole == scenes:
            return values
    return {}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
