"""build_report(): everything that is made of the records, in one folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from envgs_bench.plain_text import no_formula

from .charts.budgets import draw_budgets
from .charts.ladder import draw_ladders
from .charts.pareto_chart import draw_charts
from .charts.stability import draw_stability
from .numbers.runs import BrokenRecord, read_runs
from .outputs import delete_last_report, files_below, list_new_files
from .page.budgets import BudgetPart
from .page.html import write_page
from .page.stability import StabilityPart
from .pictures.error_maps import draw_error_maps
from .pictures.gallery import Gallery, copy_pictures, galleries, slug
from .pictures.sheets import draw_sheets
from .pictures.worst_views import draw_worst_views
from .tables.budgets import budgets_of, budgets_table
from .tables.ladder_csv import recommendations_table, rungs_table
from .tables.latex import latex
from .tables.markdown import markdown
from .tables.sections import Section, split_sections
from .tables.stability_csv import cells_table, summary_table
from .tables.structured import structured


@dataclass(frozen=True)
class Report:
    """What was made, and of what."""

    out: Path
    sections: tuple[Section, ...]
    broken: tuple[BrokenRecord, ...]

    @property
    def page(self) -> Path:
        return self.out / "index.html"

    def __str__(self) -> str:
        runs = [item.run for section in self.sections for item in section.runs]
        runs += [run for section in self.sections for run in section.stability.perturbed]
        failed = sum(not run.ok for run in runs)
        words = [f"{len(runs)} runs", *([f"{failed} of them failed"] if failed else [])]
        words += [f"{len(self.broken)} unreadable"] if self.broken else []
        return f"{', '.join(words)}: {self.page}"


def build_report(runs: Path, out: Path, only: Sequence[str] = (), exclude: Sequence[str] = ()) -> Report:
    """Write index.html, table.csv, .md, .tex and .json, pareto.png, charts/ and pictures/ of all runs under `runs`;
    ladder.csv and ladder-summary.csv where a data set has two rungs of the ladder; budgets.csv where rows differ in
    what their models may have; stability.csv and stability-summary.csv where runs are perturbed: those are in no other
    table, chart or picture.

    Runs that different protocols scored or different devices timed never share a table, nor do test and validation
    views: each group has a section of its own, and a table-<section>.csv of its own beside the first one's table.csv.
    Broken records are listed, not fatal.

    Args:
        runs: a folder with runs at any depth.
        out: created where missing. What an earlier report left there goes, nothing else does.
        only, exclude: patterns of runs, see `read_runs`.

    Raises:
        RecordError: `runs` is no folder.
        ValueError: there is no readable record under it.
    """
    found, broken = read_runs(runs, only, exclude)
    if not found and (only or exclude):
        raise ValueError(f"{runs}: no readable run is left by --only and --exclude")
    if not found:
        unreadable = f"; {len(broken)} could not be read, the first: {broken[0].reason}" if broken else ""
        raise ValueError(f"{runs}: no readable record.json under it: run `envgs-bench run` first{unreadable}")
    sections = split_sections(found)
    out.mkdir(parents=True, exist_ok=True)
    delete_last_report(out)
    before = files_below(out)
    for index, section in enumerate(sections):
        _write_csv(section.tidy, out / section.csv_name(index))
        if section.ladders:
            _write_csv(rungs_table(section.ladders), out / section.csv_name(index, "ladder"))
            _write_csv(recommendations_table(section.ladders), out / section.csv_name(index, "ladder-summary"))
        if section.stability.cases:
            _write_csv(cells_table(section.stability), out / section.csv_name(index, "stability"))
            _write_csv(summary_table(section.stability), out / section.csv_name(index, "stability-summary"))
    (out / "table.md").write_text(markdown(sections, broken), encoding="utf-8")
    (out / "table.tex").write_text(latex(sections), encoding="utf-8")
    (out / "table.json").write_text(json.dumps(structured(sections, broken)), encoding="utf-8")
    draw_charts(sections, out)
    pictures = [_pictures(section, out, index if len(sections) > 1 else None) for index, section in enumerate(sections)]
    parts = [_stability(section, out, index) for index, section in enumerate(sections)]
    steps = [
        draw_ladders(section.ladders, section.methods, out, f"charts/ladder-{index}")
        for index, section in enumerate(sections)
    ]
    budgets = [_budgets(section, out, index) for index, section in enumerate(sections)]
    write_page(out, sections, broken, pictures, parts, steps, budgets)
    list_new_files(out, before)
    return Report(out, tuple(sections), tuple(broken))


def _write_csv(table: pd.DataFrame, path: Path) -> None:
    words = table.select_dtypes(exclude="number").map(lambda text: no_formula(str(text)), na_action="ignore")
    table.assign(**words).to_csv(path, index=False)


def _stability(section: Section, out: Path, index: int) -> StabilityPart | None:
    """The section's charts and worst views under perturbations, drawn; None where nothing was perturbed."""
    if not section.stability.cases:
        return None
    charts = draw_stability(section, out, f"charts/stability-{index}")
    return StabilityPart(tuple(charts), tuple(draw_worst_views(section.stability, out, f"pictures/stability-{index}")))


def _budgets(section: Section, out: Path, index: int) -> BudgetPart | None:
    """The section's curves and maps over budgets, drawn, and their CSV; None where there are none."""
    found = budgets_of(section)
    if not found:
        return None
    _write_csv(budgets_table(found), out / section.csv_name(index, "budgets"))
    return BudgetPart(found, tuple(draw_budgets(section, found, out, f"charts/budgets-{index}")))


def _pictures(section: Section, out: Path, index: int | None) -> list[Gallery]:
    """Copy and draw the section's pictures below pictures/, by section where there are several."""
    found = galleries(section)
    for number, gallery in enumerate(found):
        names = [slug(other.dataset) for other in found]
        name = slug(gallery.dataset) if names.count(names[number]) == 1 else f"{slug(gallery.dataset)}-{number}"
        folder = f"pictures/{name}" if index is None else f"pictures/{index}-{section.slug}/{name}"
        copy_pictures(gallery, out, folder)
        draw_error_maps(gallery, out)
        gallery.sheets.update(draw_sheets(gallery, out, folder))
    return found
