"""data.js: what the page's charts and pictures are drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .columns import COST_KEYS
from .curves import QUANTITIES, training_curves
from .palette import styles
from .pareto import knobs
from .pictures import Gallery, Shot
from .sections import Section
from .structured import structured


def page_data(sections: Sequence[Section], galleries: Sequence[Sequence[Gallery]]) -> dict[str, Any]:
    """Plain JSON values; the numbers are those of table.json."""
    tables = structured(sections, ())["sections"]
    return {
        "sections": [
            _section(section, content["tables"], pictures)
            for section, content, pictures in zip(sections, tables, galleries, strict=True)
        ]
    }


def _section(section: Section, tables: list[dict[str, Any]], galleries: Sequence[Gallery]) -> dict[str, Any]:
    overrides = {item.method: _own_overrides(item.run.record.overrides) for item in section.runs}
    for table in tables:
        averaged = len(table["datasets"]) > 1
        table["name"] = f"average over {table['title']}" if averaged else table["title"]
        for column in table["columns"]:
            column["cost"] = column["key"] in COST_KEYS
        for row in table["rows"]:
            row["overrides"] = overrides.get(row["method"], [])
            for cell in row["cells"].values():
                cell["partial_average"] = averaged and cell["done"] < cell["expected"]
    charted = [i for i, table in enumerate(tables) if any(_drawn(row) for row in table["rows"])]
    return {
        "tables": tables,
        "charted": charted,
        "first_charted": next((i for i in charted if len(tables[i]["datasets"]) == 1), None),
        "styles": {m: {"color": style.color, "symbol": style.symbol} for m, style in styles(section.methods).items()},
        "knobs": knobs(list({item.method: item.label for item in section.runs}.values())),
        "galleries": [_gallery(gallery) for gallery in galleries],
        "curves": training_curves(section),
        "quantities": QUANTITIES,
    }


def _drawn(row: dict[str, Any]) -> bool:
    """Whether a chart can show the row: its frame time is known, and not the average over a part."""
    cell = row["cells"].get("frame_ms")
    return cell is not None and cell["mean"] is not None and not cell["partial_average"]


def _gallery(gallery: Gallery) -> dict[str, Any]:
    return {"dataset": gallery.dataset, "shots": [_shot(shot, gallery) for shot in gallery.shots]}


def _shot(shot: Shot, gallery: Gallery) -> dict[str, Any]:
    return {
        "title": shot.title,
        "target": gallery.files[shot.target],
        "renders": {method: gallery.files[path] for method, path in shot.renders.items()},
        "layers": {
            method: {layer: gallery.files[path] for layer, path in layers.items()}
            for method, layers in shot.layers.items()
        },
        "psnr": shot.psnr,
    }


def _own_overrides(overrides: Sequence[str]) -> list[str]:
    """What a run was told besides what its row and its folder say already."""
    told = ("method=", "dataset=", "seed=", "runs_dir=", "force=", "experiment=")
    return [override for override in overrides if not override.lstrip("+~").startswith(told)]
