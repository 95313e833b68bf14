"""table.tex: the tables as LaTeX, to be \\input; needs booktabs, and xcolor with its option table for the tints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby

from envgs_bench.plain_text import plain_line

from .entries import DAGGER, Entry, Heading, entries, headings
from .notes import caption, dropped_losses
from .sections import Section
from .table import Table

PREAMBLE = r"""% Needs booktabs, and xcolor with its option table; define these three first to mark otherwise.
\providecommand{\best}[1]{\cellcolor[HTML]{F4A582}\textbf{#1}}
\providecommand{\second}[1]{\cellcolor[HTML]{FBD3B7}\underline{#1}}
\providecommand{\third}[1]{\cellcolor[HTML]{FDF0D0}\textit{#1}}
"""
MARKS = {1: r"\best", 2: r"\second", 3: r"\third"}
SPECIAL = {
    "\\": r"\textbackslash{}",
    "±": r"$\pm$",
    "≈": r"$\approx$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "−": r"$-$",
    "Δ": r"$\Delta$",
    "°": r"$^\circ$",
    "†": r"$^\dagger$",
    "—": "---",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}


def latex(sections: Sequence[Section]) -> str:
    """A float a table, with caption and label, after a comment that names its protocol and its device; below it what †
    means."""
    parts = [PREAMBLE]
    for section in sections:
        for table in section.tables:
            words = f"{table.title}: {told}" if (told := caption(section, table)) else table.title
            label = f"tab:{section.slug}:{table.kind}:{_label(table.title)}"
            parts += [f"% {plain_line(table.title)}. {plain_line(section.title)}", _float(table, words, label), ""]
    return "\n".join(parts)


def _float(table: Table, words: str, label: str) -> str:
    head = [r"\begin{table*}[t]", r"\centering", rf"\caption{{{_escaped(words)}.}}", rf"\label{{{label}}}"]
    return "\n".join([*head, _tabular(table), r"\end{table*}"])


def _label(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _tabular(table: Table) -> str:
    titles = headings(table)
    lines = [" & ".join(_marked(entry) for entry in entries(table, row)) + r" \\" for row in table.rows]
    head = " & ".join(_escaped(heading.text) for heading in titles) + r" \\"
    body = [r"\toprule", *_groups(titles), head, r"\midrule", *lines, r"\bottomrule"]
    below = [rf"\par\noindent{{\footnotesize {_escaped(note)}\par}}" for note in dropped_losses(table)]
    return "\n".join([rf"\begin{{tabular}}{{ll{'r' * (len(titles) - 2)}}}", *body, r"\end{tabular}", *below])


def _groups(titles: Sequence[Heading]) -> list[str]:
    """The line of headings above the columns' own, each with a rule below it; none where no column has one."""
    if not any(heading.group for heading in titles):
        return []
    cells, rules, column = [], [], 1
    for name, members in groupby(titles, key=lambda heading: heading.group):
        count = len(list(members))
        cells.append(rf"\multicolumn{{{count}}}{{c}}{{{_escaped(name)}}}")
        if name:
            rules.append(rf"\cmidrule(lr){{{column}-{column + count - 1}}}")
        column += count
    return [" & ".join(cells) + r" \\", " ".join(rules)]


def _marked(entry: Entry) -> str:
    text = _escaped(entry.text + DAGGER * entry.dropped) + (r" $\approx$" if entry.tied else "")
    rank = 1 if entry.taken else entry.rank
    return f"{MARKS[rank]}{{{text}}}" if rank else text


def _escaped(text: str) -> str:
    """Any text as LaTeX that pdflatex sets; what it has no glyph for becomes a question mark."""
    return "".join(SPECIAL.get(c, c if c.isascii() and c.isprintable() else "?") for c in " ".join(text.split()))
