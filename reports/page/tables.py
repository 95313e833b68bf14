"""Tables as the page's template shows them."""

from __future__ import annotations

import re
from itertools import groupby
from typing import Any

from ..tables.entries import Entry, Heading, entries, headings
from ..tables.notes import caption, notes
from ..tables.sections import Section
from ..tables.table import Row, Table


def page_table(section: Section, table: Table) -> dict[str, Any]:
    """A table as the template shows it."""
    titles = headings(table)
    groups = [(name, len(list(members))) for name, members in groupby(titles, key=lambda heading: heading.group)]
    return {
        "title": table.title,
        "caption": caption(section, table),
        "groups": groups if len(groups) > 1 else [],
        "headings": [_heading(heading) for heading in titles],
        "rows": [_row(table, row) for row in table.rows],
        "notes": notes(section, table),
    }


def _heading(heading: Heading) -> dict[str, str]:
    text = re.sub(" (?=[↑↓°])", "\N{NO-BREAK SPACE}", heading.text)
    return {"text": text, "explanation": heading.explanation}


def _row(table: Table, row: Row) -> dict[str, Any]:
    return {
        "published_only": not row.attempts,
        "failed": row.done < row.attempts,
        "entries": [_entry(entry) for entry in entries(table, row)],
    }


def _entry(entry: Entry) -> dict[str, Any]:
    value, spread = number_and_spread(entry.text) if entry.number else (entry.text, "")
    return {
        "value": value,
        "spread": spread,
        "rank": entry.rank,
        "tied": entry.tied,
        "dropped": entry.dropped,
    }


def number_and_spread(text: str) -> tuple[str, str]:
    """A cell's number, and apart from it "± 0.1" or "[0.1, 0.3]"; "" where it has neither."""
    value, *spread = re.split(r" (?=± |\[)", text, maxsplit=1)
    return value, "".join(spread)
