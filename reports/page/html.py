"""index.html: a page that opens offline, with its scripts, its data and its pictures beside it."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from envgs_bench.run_folder import LOG_NAME, RECORD_NAME

from ..numbers.runs import BrokenRecord
from ..pictures.gallery import Gallery
from ..tables.chapter import Chapter
from ..tables.entries import LEGEND
from ..tables.sections import Section
from .data import write_data
from .headlines import headlines
from .methods import method_parts
from .origin import commands, dropped_losses, failures, origins
from .plotly_script import copy_plotly
from .tables import page_table
from .templates import ASSETS, rendered

SCRIPTS = ("marks.js", "tables.js", "axes.js", "chart.js", "curves.js", "viewer.js", "datasets.js", "address.js")
GLYPHS = {"ok": "✓", "failed": "✕", "diverged": "∿", "out_of_memory": "▣", "timeout": "◷", "interrupted": "‖"}


@dataclass(frozen=True)
class Part:
    """A part of a section's page that was made elsewhere: its place's name, its heading and what stands there."""

    name: str
    title: str
    html: Markup


@dataclass(frozen=True)
class PageSection:
    """What the page shows of a section: its tables, its pictures, already drawn, and the parts made elsewhere."""

    chapter: Chapter
    galleries: Sequence[Gallery]
    parts: Sequence[Part]


def write_page(
    out: Path,
    shown: Sequence[PageSection],
    broken: Sequence[BrokenRecord],
    rules: Sequence[str],
    for_print: bool,
    under_way: str,
) -> Path:
    """Write index.html and assets/ into `out`.

    Args:
        rules: of style, of the parts.
        for_print: whether there are LaTeX tables, and a chart with a PDF for every pair of columns.
        under_way: how far the sweep has come; "" where there is none, or it has ended.
    """
    assets = out / "assets"
    assets.mkdir(parents=True, exist_ok=True)
    sections = [item.chapter.section for item in shown]
    galleries = [item.galleries for item in shown]
    data = write_data(assets, sections, galleries)
    copy_plotly(assets / "plotly.min.js")
    for name in SCRIPTS:
        shutil.copyfile(ASSETS / name, assets / name)
    style = (ASSETS / "report.css").read_text(encoding="utf-8")
    (assets / "report.css").write_text("\n".join([style, *rules]), encoding="utf-8")
    content = {
        "sections": [_section(item, index, data["sections"][index], out) for index, item in enumerate(shown)],
        "broken": broken,
        "tiles": _tiles(sections, broken),
        "headlines": [found for s, g in zip(sections, galleries, strict=True) if (found := headlines(s, g, out))],
        "legend": LEGEND,
        "glyphs": GLYPHS,
        "names": {status: status.replace("_", " ") for status in GLYPHS},
        "for_print": for_print,
        "under_way": under_way,
        "scripts": ["plotly.min.js", "data.js", *SCRIPTS],
        "version": _version(),
    }
    page = out / "index.html"
    page.write_text(rendered(ASSETS / "index.html.j2", content, out), encoding="utf-8")
    return page


def _section(item: PageSection, index: int, data: dict[str, Any], out: Path) -> dict[str, Any]:
    section, galleries = item.chapter.section, item.galleries
    parts = {
        ("chart", "Chart"): bool(data["subjects"]),
        ("tables", "Tables"): bool(section.runs),
        **{(part.name, part.title): True for part in item.parts},
        ("pictures", "Pictures"): bool(galleries),
        ("training", "Training"): bool(data["curves"]),
        ("runs", "Runs"): bool(section.runs),
        ("methods", "Methods"): bool(section.runs),
        ("provenance", "Provenance"): True,
    }
    return {
        "id": f"section-{index}",
        "title": section.title,
        "short": section.short,
        "protocol": section.protocol,
        "device": section.device,
        "csv": section.csv_name(index),
        "parts": {name: title for (name, title), there in parts.items() if there},
        "tables": _table_groups(item.chapter),
        "studies": item.parts,
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


def _table_groups(chapter: Chapter) -> list[dict[str, Any]]:
    """The tables by kind; a note that all tables of a kind share is told once, after them."""
    parts = []
    for group in chapter.groups:
        if not group.elsewhere:
            tables = [page_table(chapter.section, table) for table in group.tables]
            shared = [note for note in tables[0]["notes"] if all(note in table["notes"] for table in tables)]
            for table in tables:
                table["notes"] = [note for note in table["notes"] if note not in shared]
            parts.append({"title": group.title, "unfolded": group.unfolded, "tables": tables, "notes": shared})
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
    perturbed = sum(len(section.perturbed) for section in sections)
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


def _version() -> str:
    try:
        return version("envgs-bench")
    except PackageNotFoundError:
        return ""
