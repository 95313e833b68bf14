"""Gallery: which test views a report shows of a data set, and their pictures copied beside the page."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from envgs_bench.parts import LAYERS
from envgs_bench.run_folder import (
    exact_normal_path,
    has_renders,
    is_file_name,
    is_png,
    layers_of,
    mask_path,
    render_path,
    target_path,
)

from ..numbers.runs import Run
from ..tables.sections import Section

MAX_VIEWS = 8
MAX_PICTURES = 800  # over all data sets and methods together, before fewer views are shown of each
SHOWN_FIRST = ("error", "flip", *LAYERS, "normal", "depth")  # the layers of a view, in this order
REGION = "reflective"
NORMALS = "normal_degrees"  # the score of a view's normals


@dataclass(frozen=True)
class Shot:
    """One test view as the methods drew it. Paths are those of the runs' own files."""

    view: str
    roles: tuple[str, ...]  # "worst", "median", both or none
    target: Path
    renders: dict[str, Path]  # method -> picture, of its first finished seed
    layers: dict[str, dict[str, Path]]  # method -> layer -> picture
    psnr: dict[str, float]  # method -> dB, of the same run
    degrees: dict[str, float]  # method -> mean angle between its normals and the exact ones, of the same run
    normal: Path | None  # the exact normals, where the data set knows them
    mask: Path | None  # where the view shows REGION

    @property
    def title(self) -> str:
        return f"{' and '.join(self.roles)} view {self.view}" if self.roles else f"view {self.view}"


@dataclass(frozen=True)
class Gallery:
    dataset: str
    methods: tuple[str, ...]  # those with pictures, in the tables' order
    missing: dict[str, str]  # method -> why there is none
    shots: tuple[Shot, ...] = ()
    files: dict[Path, str] = field(default_factory=dict)  # a run's file -> its copy, relative to the report
    flips: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)  # (view, method) -> {"flip": file}
    sheets: dict[str, str] = field(default_factory=dict)  # title -> file, relative to the report


def galleries(section: Section) -> list[Gallery]:
    """A gallery for each of the section's data sets that left pictures."""
    share = MAX_PICTURES // max(1, len(section.datasets) * len(section.methods))
    found = [_gallery(section, dataset, max(2, min(MAX_VIEWS, share))) for dataset in section.datasets]
    return [gallery for gallery in found if gallery.shots]


def copy_pictures(gallery: Gallery, out: Path, folder: str) -> None:
    """Copy what the page shows into `out`/`folder`, and remember where each file went."""
    for number, shot in enumerate(gallery.shots):
        stem = f"{number:02d}-{slug(shot.view)}"
        wanted = {f"{stem}-target": shot.target}
        if shot.normal is not None:
            wanted[f"{stem}-target-normal"] = shot.normal
        for index, method in enumerate(gallery.methods):
            name = f"{stem}-{index:02d}-{slug(method)}"
            if method in shot.renders:
                wanted[name] = shot.renders[method]
            for layer, path in shot.layers.get(method, {}).items():
                wanted[f"{name}-{slug(layer)}"] = path
        for name, path in wanted.items():
            relative = f"{folder}/views/{name}.png"
            (out / relative).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, out / relative)
            gallery.files[path] = relative


def ordered_layers(names: Iterable[str]) -> list[str]:
    """The names of SHOWN_FIRST first and in their order, then the others."""
    return sorted(names, key=lambda name: (SHOWN_FIRST.index(name) if name in SHOWN_FIRST else len(SHOWN_FIRST), name))


def slug(name: str) -> str:
    """A short name of letters, digits, dots and underscores: safe in paths and addresses."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", name).strip("-.")[:60] or "unnamed"


def _gallery(section: Section, dataset: str, most: int) -> Gallery:
    chosen: dict[str, Run] = {}
    missing: dict[str, str] = {}
    difficulty: dict[str, list[float]] = {}
    for item in section.of(dataset):
        if item.run.ok:
            for view, psnr in item.run.of_views("psnr").items():
                difficulty.setdefault(view, []).append(psnr)
            if has_renders(item.run.folder):
                chosen.setdefault(item.method, item.run)
        missing.setdefault(item.method, "no pictures" if item.run.ok else item.run.record.status.replace("_", " "))
    shots = []
    for view, roles in _views(difficulty, most):
        shot = _shot(view, roles, chosen)
        if shot is not None:
            shots.append(shot)
    drawn = tuple(method for method in chosen if any(method in shot.renders for shot in shots))
    return Gallery(dataset, drawn, {m: why for m, why in missing.items() if m not in drawn}, tuple(shots))


def _views(difficulty: dict[str, list[float]], most: int) -> Iterable[tuple[str, tuple[str, ...]]]:
    """The views to show, worst first by the mean PSNR over all finished runs, and the roles that they play."""
    ordered = sorted((float(np.mean(psnr)), view) for view, psnr in difficulty.items() if is_file_name(view))
    views = [view for _, view in ordered]
    if not views:
        return []
    worst, median = views[0], views[(len(views) - 1) // 2]
    roles = {view: tuple(r for r, v in (("worst", worst), ("median", median)) if v == view) for view in views}
    first = [worst, *([median] if median != worst else [])]
    kept = (first + [view for view in views if view not in first])[:most]
    return [(view, roles[view]) for view in sorted(kept, key=views.index)]


def _shot(view: str, roles: tuple[str, ...], chosen: dict[str, Run]) -> Shot | None:
    renders = {m: path for m, run in chosen.items() if is_png(path := render_path(run.folder, view))}
    targets = [path for m in renders if is_png(path := target_path(chosen[m].folder, view))]
    normals = [path for m in renders if is_png(path := exact_normal_path(chosen[m].folder, view))]
    masks = [path for m in renders if is_png(path := mask_path(chosen[m].folder, view, REGION))]
    if not targets:
        return None
    return Shot(
        view=view,
        roles=roles,
        target=targets[0],
        renders=renders,
        layers={m: layers for m in renders if (layers := _layers(chosen[m].folder, view))},
        psnr={m: psnr for m in renders if (psnr := chosen[m].of_views("psnr").get(view)) is not None},
        degrees={m: angle for m in renders if (angle := chosen[m].of_views(NORMALS).get(view)) is not None},
        normal=normals[0] if normals else None,
        mask=masks[0] if masks else None,
    )


def _layers(run: Path, view: str) -> dict[str, Path]:
    found = layers_of(run, view)
    return {name: found[name] for name in ordered_layers(found) if is_png(found[name])}
