"""table.tex: the tables as LaTeX, to be \\input; needs booktabs, and xcolor with its option table for the tints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import groupby

from envgs_bench.plain_text import plain_line

from .chapter import Chapter
from .entries import DAGGER, Entry, Heading, entries, headings
from .latex_text import escaped
from .latex_text import label as label_part
from .notes import caption, dropped_losses
from .table import Table

PREAMBLE = r"""% Needs booktabs, and xcolor with its option table; define these three first to mark otherwise.
\providecommand{\best}[1]{\cellcolor[HTML]{F4A582}\textbf{#1}}
\providecommand{\second}[1]{\cellcolor[HTML]{FBD3B7}\underline{#1}}
\providecommand{\third}[1]{\cellcolor[HTML]{FDF0D0}\textit{#1}}
"""
MARKS = {1: r"\best", 2: r"\second", 3: r"\third"}


def latex(chapters: Sequence[Chapter]) -> str:
    """A float a table, with caption and label, after a comment that names its protocol and its device; below it what †
    means."""
    parts, labels = [PREAMBLE], Counter[str]()
    for chapter in chapters:
        section = chapter.section
        for table in chapter.tables:
            words = f"{table.title}: {told}" if (told := caption(section, table)) else table.title
            label = f"tab:{section.slug}:{table.kind}:{label_part(table.title)}"
            labels[label] += 1
            label += f"-{labels[label]}" if labels[label] > 1 else ""
            parts += [f"% {plain_line(table.title)}. {plain_line(section.title)}", _float(table, words, label), ""]
    return "\n".join(parts)


def _float(table: Table, words: str, label: str) -> str:
    head = [r"\begin{table*}[t]", r"\centering", rf"\caption{{{escaped(words)}.}}", rf"\label{{{label}}}"]
    return "\n".join([*head, _tabular(table), r"\end{table*}"])


def _tabular(table: Table) -> str:
    titles = headings(table)
    lines = [" & ".join(_marked(entry) for entry in entries(table, row)) + r" \\" for row in table.rows]
    head = " & ".join(escaped(heading.text) for heading in titles) + r" \\"
    body = [r"\toprule", *_groups(titles), head, r"\midrule", *lines, r"\bottomrule"]
    below = [rf"\par\noindent{{\footnotesize {escaped(note)}\par}}" for note in dropped_losses(table)]
    return "\n".join([rf"\begin{{tabular}}{{ll{'r' * (len(titles) - 2)}}}", *body, r"\end{tabular}", *below])


def _groups(titles: Sequence[Heading]) -> list[str]:
    """The line of headings above the columns' own, each with a rule below it; none where no column has one."""
    if not any(heading.group for heading in titles):
        return []
    cells, rules, column = [], [], 1
    for name, members in groupby(titles, key=lambda heading: heading.group):
        count = len(list(members))
        cells.append(rf"\multicolumn{{{count}}}{{c}}{{{escaped(name)}}}")
        if name:
            rules.append(rf"\cmidrule(lr){{{column}-{column + count - 1}}}")
        column += count
    return [" & ".join(cells) + r" \\", " ".join(rules)]


def _marked(entry: Entry) -> str:
    text = escaped(entry.text + DAGGER * entry.dropped) + (r" $\approx$" if entry.tied else "")
    rank = 1 if entry.taken else entry.rank
    return f"{MARKS[rank]}{{{text}}}" if rank else text
