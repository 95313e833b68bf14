"""What the page's charts and pictures are drawn from: data.js, and a file a data set for its training curves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..charts.curves import QUANTITIES, training_curves
from ..charts.palette import styles
from ..pictures.gallery import Gallery, Shot
from ..tables.columns import COSTS, Column, accuracy_columns, main_columns
from ..tables.sections import Section
from ..tables.table import Cell, Row, Table
from .sizes import png_size

COST_KEYS = {column.key for column in COSTS}
DIGITS = 7  # significant ones, of a point in a chart


def write_data(folder: Path, sections: Sequence[Section], galleries: Sequence[Sequence[Gallery]]) -> dict[str, Any]:
    """Write data.js and curves-<section>-<data set>.js into `folder`; what data.js holds, as plain JSON values."""
    data: dict[str, Any] = {
        "sections": [_section(s, g) for s, g in zip(sections, galleries, strict=True)],
        "quantities": QUANTITIES,
    }
    for number, section in enumerate(sections):
        for place, (dataset, curves) in enumerate(training_curves(section)):
            name = f"curves-{number}-{place}.js"
            (folder / name).write_text(f"window.addCurves({number}, {place}, {_json(curves)});\n", encoding="utf-8")
            data["sections"][number]["curves"].append({"dataset": dataset, "file": f"assets/{name}"})
    (folder / "data.js").write_text(f"window.REPORT = {_json(data)};\n", encoding="utf-8")
    return data


def _json(content: Any) -> str:
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _section(section: Section, galleries: Sequence[Gallery]) -> dict[str, Any]:
    overrides = {item.method: _own_overrides(item.run.record.overrides) for item in section.runs}
    subjects = [subject for table in section.subjects if (subject := _subject(table, overrides))["rows"]]
    accurate = {column.key for column in accuracy_columns(section.metrics)}
    alone = [i for i, subject in enumerate(subjects) if subject["count"] == 1]
    return {
        "columns": {
            column.key: {
                "title": column.title,
                "axis": column.axis,
                "better": column.better,
                "axis_of": "cost" if column.key in COST_KEYS else "accuracy" if column.key in accurate else None,
            }
            for column in main_columns(section.metrics)
        },
        "subjects": subjects,
        "first": alone[0] if alone else 0,
        "styles": {
            m: {"color": style.color, "symbol": style.symbol}
            for m, style in styles(section.methods, section.cards).items()
        },
        "sweeps": section.sweeps,
        "galleries": [_gallery(gallery) for gallery in galleries],
        "curves": [],
    }


def _subject(table: Table, overrides: dict[str, list[str]]) -> dict[str, Any]:
    """A data set, or the mean over several, with every number that a chart can show of it."""
    rows = [
        {
            "method": row.method,
            "runs": row.runs_text,
            "complete": row.done == row.attempts,
            "done": f"{row.done}/{row.attempts}",
            "overrides": overrides.get(row.method, []),
            "values": values,
        }
        for row in table.rows
        if (values := _values(row, table.columns))
    ]
    count = len(table.datasets)
    return {"title": table.title, "name": f"{table.title} (mean of {count})" if count > 1 else table.title,
            "count": count, "rows": rows}  # fmt: skip


def _values(row: Row, columns: Sequence[Column]) -> dict[str, list[Any]]:
    """Column -> mean, lower and upper end of the interval or None, text."""
    cells = [(column.key, row.cells[column.key]) for column in columns if column.key in row.cells]
    return {key: [*_ends(cell), cell.text] for key, cell in cells if cell.shown}


def _ends(cell: Cell) -> list[float | None]:
    assert cell.mean is not None
    scale = float(cell.column.scale)
    interval = cell.interval or (None, None)
    return [_short(float(cell.mean) * scale), *(None if end is None else _short(end * scale) for end in interval)]


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _gallery(gallery: Gallery) -> dict[str, Any]:
    return {"dataset": gallery.dataset, "shots": [_shot(shot, gallery) for shot in gallery.shots]}


def _shot(shot: Shot, gallery: Gallery) -> dict[str, Any]:
    return {
        "title": shot.title,
        "target": {"image": gallery.files[shot.target]}
        | ({"normal": gallery.files[shot.normal]} if shot.normal is not None else {}),
        "size": png_size(shot.target),
        "pictures": {
            method: {
                "image": gallery.files[path],
                **gallery.flips.get((shot.view, method), {}),
                **{layer: gallery.files[file] for layer, file in shot.layers.get(method, {}).items()},
            }
            for method, path in shot.renders.items()
        },
        "psnr": shot.psnr,
        "degrees": shot.degrees,
    }


def _own_overrides(overrides: Sequence[str]) -> list[str]:
    """What a run was told besides what its row and its folder say already."""
    told = ("method=", "dataset=", "seed=", "runs_dir=", "force=", "experiment=")
    return [override for override in overrides if not override.lstrip("+~").startswith(told)]
