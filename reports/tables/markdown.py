"""table.md: every table as Markdown that reads well unrendered too."""

from __future__ import annotations

from collections.abc import Sequence

from envgs_bench.plain_text import plain_line

from ..numbers.runs import BrokenRecord
from .chapter import Chapter
from .entries import LEGEND, Entry, entries, headings
from .notes import caption, notes
from .table import Table


def markdown(chapters: Sequence[Chapter], broken: Sequence[BrokenRecord]) -> str:
    """One part a section (protocol and device), averages first, then a table a data set; then what failed."""
    parts = ["# Results", ""]
    for chapter in chapters:
        parts += _chapter(chapter)
    if broken:
        parts += ["## Unreadable records", "", *(f"* {_escaped(item.reason)}" for item in broken), ""]
    return "\n".join(parts).rstrip() + "\n"


def _chapter(chapter: Chapter) -> list[str]:
    section = chapter.section
    lines = [f"## {_escaped(section.title)}", "", _escaped(section.protocol.description), ""]
    for table in chapter.tables:
        lines += [f"### {_escaped(table.title)}", "", _escaped(caption(section, table)), "", *_table(table), ""]
        for note in notes(section, table):
            lines += [_escaped(note), ""]
    lines += [LEGEND + ".", ""]
    failures = [item for item in section.runs if not item.run.ok]
    if failures:
        lines += ["### Failed runs", ""]
        for item in failures:
            error = item.run.record.error
            why = f": {error}" if error else ""
            status = item.run.record.status.replace("_", " ")
            lines.append("* " + _escaped(f"{item.dataset}, {item.method}, seed {item.run.record.seed}: {status}{why}"))
        lines.append("")
    return lines


def _table(table: Table) -> list[str]:
    rows = [[_emphasized(entry) for entry in entries(table, row)] for row in table.rows]
    titles = [_escaped(heading.full) for heading in headings(table)]
    alignment = [":--", ":--", *["--:"] * (len(titles) - 2)]
    return ["| " + " | ".join(cells) + " |" for cells in (titles, alignment, *rows)]


def _emphasized(entry: Entry) -> str:
    if entry.rank == 1:
        return f"**{entry.text}**" + entry.marked.removeprefix(entry.text)
    text = entry.marked if entry.number else _escaped(entry.marked)
    return f"**{text}**" if entry.taken else text


def _escaped(text: str) -> str:
    """Text of a record, harmless in a table's cell: no markup, no line breaks, nothing that a terminal obeys."""
    harmless_text = plain_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for markup, harmless in (("\\", "\\\\"), ("|", r"\|"), ("`", r"\`"), ("*", r"\*"), ("](", r"]\(")):
        harmless_text = harmless_text.replace(markup, harmless)
    return harmless_text
