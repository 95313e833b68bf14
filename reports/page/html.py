"""index.html: a page that opens offline, with its scripts, its data and its pictures beside it."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from envgs_bench.run_folder import LOG_NAME, RECORD_NAME

from ..charts.ladder import LadderChart
from ..numbers.runs import BrokenRecord
from ..pictures.gallery import Gallery
from ..tables.entries import DAGGER, LEGEND
from ..tables.layouts import KINDS
from ..tables.sections import Section
from .budgets import BudgetPart, budget_data
from .data import write_data
from .headlines import headlines
from .ladder import ladder_data
from .methods import method_parts
from .origin import commands, dropped_losses, failures, origins
from .sizes import png_size
from .stability import StabilityPart, stability_data
from .tables import page_table

SCRIPTS = ("marks.js", "tables.js", "axes.js", "chart.js", "curves.js", "viewer.js", "datasets.js", "address.js")
GLYPHS = {"ok": "✓", "failed": "✕", "diverged": "∿", "out_of_memory": "▣", "timeout": "◷", "interrupted": "‖"}
ORDINALS = {1: "best", 2: "second", 3: "third"}


def write_page(
    out: Path,
    sections: Sequence[Section],
    broken: Sequence[BrokenRecord],
    galleries: Sequence[Sequence[Gallery]],
    stability: Sequence[StabilityPart | None],
    ladders: Sequence[Sequence[LadderChart]],
    budgets: Sequence[BudgetPart | None],
) -> Path:
    """Write index.html and assets/ into `out`; pictures and charts are those of each section, already drawn."""
    assets = out / "assets"
    assets.mkdir(parents=True, exist_ok=True)
    data = write_data(assets, sections, galleries)
    (assets / "plotly.min.js").write_text(get_plotlyjs(), encoding="utf-8")
    with as_file(files(__package__) / "assets") as source:
        for name in ("report.css", *SCRIPTS):
            shutil.copyfile(source / name, assets / name)
        environment = Environment(
            loader=FileSystemLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True
        )
        html = environment.get_template("index.html.j2").render(
            sections=[
                _section(section, index, data["sections"][index], galleries[index], budgets[index], out)
                | {"stability": stability_data(section, index, stability[index])}
                | {"ladder": ladder_data(section, index, ladders[index])}
                | {"budgets": budget_data(section, index, budgets[index])}
                for index, section in enumerate(sections)
            ],
            broken=broken,
            tiles=_tiles(sections, broken),
            sized=lambda path, shown=None: _sized(out / path, shown),
            headlines=[found for s, g in zip(sections, galleries, strict=True) if (found := headlines(s, g, out))],
            legend=LEGEND,
            dagger=DAGGER,
            glyphs=GLYPHS,
            names={status: status.replace("_", " ") for status in GLYPHS},
            ordinals=ORDINALS,
            scripts=["plotly.min.js", "data.js", *SCRIPTS],
            version=_version(),
        )
    page = out / "index.html"
    page.write_text(html, encoding="utf-8")
    return page


def _section(
    section: Section,
    index: int,
    data: dict[str, Any],
    galleries: Sequence[Gallery],
    budgets: BudgetPart | None,
    out: Path,
) -> dict[str, Any]:
    parts = {
        "Chart": bool(data["subjects"]),
        "Ladder": bool(section.ladders),
        "Tables": bool(section.runs),
        "Budgets": budgets is not None,
        "Stability": bool(section.stability.cases),
        "Pictures": bool(galleries),
        "Training": bool(data["curves"]),
        "Runs": bool(section.runs),
        "Methods": bool(section.runs),
        "Provenance": True,
    }
    return {
        "id": f"section-{index}",
        "title": section.title,
        "short": section.short,
        "protocol": section.protocol,
        "device": section.device,
        "csv": section.csv_name(index),
        "parts": [name for name, there in parts.items() if there],
        "tables": _parts(section),
        "galleries": galleries,
        "statuses": Counter(item.run.record.status for item in section.runs).most_common(),
        "datasets": section.datasets,
        "matrix": _matrix(section, out),
        "failures": failures(section),
        "superseded": len(section.superseded),
        "contracts": sorted({item.run.record.timing.contract for item in section.runs if item.run.record.timing}),
        "origins": origins(section),
        "commands": commands(section),
        "dropped": dropped_losses(section),
        "methods": (described := method_parts(section, f"section-{index}-method")),
        "method_links": {method["name"]: method["id"] for method in described},
    }


def _parts(section: Section) -> list[dict[str, Any]]:
    """The tables by kind; a note that all tables of a kind share is told once, after them."""
    parts = []
    for kind, title in KINDS.items():
        tables = [page_table(section, table) for table in section.tables if table.kind == kind]
        if tables:
            shared = [note for note in tables[0]["notes"] if all(note in table["notes"] for table in tables)]
            for table in tables:
                table["notes"] = [note for note in table["notes"] if note not in shared]
            parts.append({"kind": kind, "title": title, "tables": tables, "notes": shared})
    return parts


def _matrix(section: Section, out: Path) -> list[dict[str, Any]]:
    """A row a method, a cell a data set, in it its runs' seeds and statuses."""
    cells: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for dataset in section.datasets:
        for item in section.of(dataset):
            run = {"seed": item.run.record.seed, "status": item.run.record.status, **_links(item.run.folder, out)}
            cells.setdefault((dataset, item.method), []).append(run)
    return [{"method": m, "cells": [cells.get((d, m), []) for d in section.datasets]} for m in section.methods]


def _links(run: Path, out: Path) -> dict[str, str]:
    """The run's folder as people read it, and the addresses of its record and its log, where there is one."""
    place = Path(os.path.relpath(run, out))
    files = {"record": run / RECORD_NAME, "log": run / LOG_NAME}
    links = {name: quote((place / file.name).as_posix()) for name, file in files.items() if file.is_file()}
    return {"folder": run.name, "record": "", "log": "", **links}


def _tiles(sections: Sequence[Section], broken: Sequence[BrokenRecord]) -> list[dict[str, str]]:
    """What the head of the page says at a glance."""
    runs = [item for section in sections for item in section.runs]
    failed = sum(not item.run.ok for item in runs) + len(broken)
    methods = {item.method for item in runs}
    datasets = {item.dataset for item in runs}
    tiles = [
        {"name": "methods", "value": str(len(methods)), "note": ""},
        {"name": "data sets", "value": str(len(datasets)), "note": next(iter(datasets)) if len(datasets) == 1 else ""},
        {"name": "runs", "value": str(len(runs)), "note": f"{failed} failed" if failed else "all finished"},
    ]
    perturbed = sum(len(section.stability.perturbed) for section in sections)
    if perturbed:
        tiles.append({"name": "perturbed runs", "value": str(perturbed), "note": ""})
    table = next(iter(sections[0].subjects), None)
    if table is None:
        return tiles
    for key, name in (("psnr", "most accurate"), ("frame_ms", "fastest")):
        best = [row for row in table.rows if (cell := row.cells.get(key)) and cell.rank == 1]
        column = next((column for column in table.columns if column.key == key), None)
        if best and column:
            unit = "dB" if key == "psnr" else "ms"
            mean = best[0].cells[key].mean
            note = f"{column.text(mean)} {unit}" if mean is not None else ""
            tiles.append({"name": f"{name}, {table.title}", "value": best[0].method, "note": note})
    return tiles


def _sized(picture: Path, shown: int | None) -> Markup:
    """The picture's attributes of size, px; those of `shown` px in width where that is given."""
    width, height = png_size(picture)
    if shown is not None and width:
        width, height = shown, round(height * shown / width)
    return Markup(f'width="{width}" height="{height}"')


def _version() -> str:
    try:
        return version("envgs-bench")
    except PackageNotFoundError:
        return ""
