"""build_report(): everything that is made of the records, in one folder."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from envgs_bench.plain_text import no_formula

from .charts.drawn import Canvas
from .charts.pareto_chart import draw_charts
from .numbers.runs import BrokenRecord, read_runs
from .outputs import in_place_of_the_last
from .page.html import PageSection, write_page
from .pictures.error_maps import draw_error_maps
from .pictures.gallery import Gallery, copy_pictures, galleries, slug
from .pictures.sheets import draw_sheets
from .studies import STUDIES
from .studies.study import Study, has_page, page_part, page_rules
from .tables.chapter import Chapter, TableGroup, ordinary_groups
from .tables.latex import latex
from .tables.markdown import markdown
from .tables.sections import Section, split_sections
from .tables.structured import structured

if TYPE_CHECKING:
    import pandas as pd


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
        runs += [item.run for section in self.sections for item in section.perturbed]
        endings = Counter(
            "interrupted" if run.record.status == "interrupted" else "failed" for run in runs if not run.ok
        )
        words = [f"{len(runs)} run{'s' if len(runs) != 1 else ''}"]
        words += [f"{count} of them {ending}" for ending, count in sorted(endings.items())]
        words += [f"{len(self.broken)} unreadable"] if self.broken else []
        return f"{', '.join(words)}: {self.page}"


def build_report(
    runs: Path,
    out: Path,
    only: Sequence[str] = (),
    exclude: Sequence[str] = (),
    for_print: bool = False,
    under_way: str = "",
) -> Report:
    """Write index.html, table.csv, .md and .json, pareto.png and pictures/ of all runs under `runs`, and the files of
    each study that finds something. Perturbed runs are in their study alone.

    Runs that different protocols scored or different devices timed never share a table, nor do test and validation
    views or repaired data and data as they were: each group has a section of its own, and a table-<section>.csv of its
    own beside the first one's table.csv.
    Broken records are listed, not fatal.

    Args:
        runs: a folder with runs at any depth.
        out: created where missing. What an earlier report left there goes, nothing else does.
        only, exclude: patterns of runs, see `read_runs`.
        for_print: also what a paper takes: table.tex, a PDF beside every chart, and charts/ of every accuracy against
            every cost.
        under_way: how far the sweep has come of which these are the first runs; a page that says so loads itself again
            every few seconds.

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
    studies = [studies_of(section) for section in sections]
    chapters = [chapter_of(*pair) for pair in zip(sections, studies, strict=True)]
    with in_place_of_the_last(out):
        canvas = Canvas(out, pdf=for_print)
        (out / "table.md").write_text(markdown(chapters, broken), encoding="utf-8")
        (out / "table.json").write_text(json.dumps(structured(chapters, broken)), encoding="utf-8")
        if for_print:
            (out / "table.tex").write_text(latex(chapters), encoding="utf-8")
        draw_charts(sections, canvas, every_pair=for_print)
        shown = [
            _page_section(chapter, own, index, len(sections) > 1, canvas)
            for index, (chapter, own) in enumerate(zip(chapters, studies, strict=True))
        ]
        write_page(out, shown, broken, list(map(page_rules, STUDIES)), for_print, under_way)
    return Report(out, tuple(sections), tuple(broken))


def studies_of(section: Section) -> list[Study]:
    """The studies that find something in the section."""
    return [found for study in STUDIES if (found := study.of(section)) is not None]


def chapter_of(section: Section, studies: Sequence[Study]) -> Chapter:
    """All tables of a section: those of studies that come first, the ordinary ones, those of the other studies."""
    groups = {study.name: _tables(section, study) for study in studies}
    groups = {name: group for name, group in groups.items() if group.tables}
    leading = [groups[study.name] for study in studies if study.first and study.name in groups]
    others = [groups[study.name] for study in studies if not study.first and study.name in groups]
    return Chapter(section, (*leading, *ordinary_groups(section), *others))


def _tables(section: Section, study: Study) -> TableGroup:
    tables = tuple(section.with_dropped_losses(table) for table in study.tables())
    return TableGroup(study.name, study.title, tables, unfolded=True, elsewhere=has_page(type(study)))


def _page_section(chapter: Chapter, studies: Sequence[Study], index: int, several: bool, canvas: Canvas) -> PageSection:
    """What the page shows of a section: its numbers are written, its charts and pictures drawn."""
    section = chapter.section
    _write_csv(section.tidy, canvas.out / section.csv_name(index))
    pictures = _pictures(section, canvas.out, index if several else None)
    parts = []
    for study in studies:
        files = {}
        for name, table in study.csv().items():
            files[name] = section.csv_name(index, name)
            _write_csv(table, canvas.out / files[name])
        drawn = study.draw(canvas, index)
        if has_page(type(study)):
            parts.append(page_part(study, drawn, files, canvas.out))
    return PageSection(chapter, pictures, parts)


def _write_csv(table: pd.DataFrame, path: Path) -> None:
    words = table.select_dtypes(exclude="number").map(lambda text: no_formula(str(text)), na_action="ignore")
    table.assign(**words).to_csv(path, index=False)


def _pictures(section: Section, out: Path, index: int | None) -> list[Gallery]:
    """Copy and draw the section's pictures below pictures/, by section where there are several."""
    found = galleries(section)
    for number, gallery in enumerate(found):
        names = [slug(other.dataset).lower() for other in found]
        name = slug(gallery.dataset) if names.count(names[number]) == 1 else f"{slug(gallery.dataset)}-{number}"
        folder = f"pictures/{name}" if index is None else f"pictures/{index}-{section.slug}/{name}"
        copy_pictures(gallery, out, folder)
        draw_error_maps(gallery, out)
        gallery.sheets.update(draw_sheets(gallery, out, folder))
    return found
