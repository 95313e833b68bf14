"""Study: what every study does, so that a report needs to know none of them."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self

from ..charts.drawn import Canvas, DrawnChart
from ..kept.tables import PageTable
from ..page.html import Part
from ..page.templates import rendered
from ..tables.sections import Section
from ..tables.table import Table

if TYPE_CHECKING:
    import pandas as pd


TEMPLATE, RULES = "page.html.j2", "page.css"  # in a study's folder


@dataclass(frozen=True)
class Drawn:
    """What a study drew: charts, and sheets of pictures."""

    charts: tuple[DrawnChart, ...] = ()
    sheets: tuple[DrawnChart, ...] = ()


class Study(Protocol):
    """A study of one section: its numbers, and what they are in every format.

    A study is a class in a folder of its own, which derives from this and is listed in `STUDIES`. What it does not say
    it does not have. Where its folder has a `page.html.j2`, the page has a part of its own for it, drawn with what
    `page` returns, and with the rules of `page.css` beside it; else its tables stand among the ordinary ones.

    Attributes:
        name: of its files, its tables' kind and its place on the page; letters and dashes.
        title: of its tables, and of its part of the page.
        first: whether its tables come before the ordinary ones.
        page_tables: kind -> what the documentation's pages may ask for of kept runs.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    first: ClassVar[bool] = False
    page_tables: ClassVar[Mapping[str, PageTable]] = {}

    @classmethod
    def of(cls, section: Section) -> Self | None:
        """The study of the section's runs; None where there is nothing to find out."""

    def tables(self) -> Sequence[Table]:
        """Its tables, of the kind `name`."""
        return ()

    def csv(self) -> Mapping[str, pd.DataFrame]:
        """Its numbers: name of a file, without suffix -> one row a number."""
        return {}

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        """Draw its charts and sheets; `number` is the section's, for their names."""
        return Drawn()

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        """What its template shows beside `charts`, `sheets` and `files`, as plain values."""
        return {}


def page_part(study: Study, drawn: Drawn, files: Mapping[str, str], out: Path) -> Part:
    """The study's part of the page, of a study that has one.

    Args:
        files: name of a table of `csv` -> the file that holds it.
    """
    shown = {"charts": drawn.charts, "sheets": drawn.sheets, "files": files, "title": study.title}
    html = rendered(folder_of(type(study)) / TEMPLATE, shown | dict(study.page(drawn)), out)
    return Part(study.name, study.title, html)


def page_rules(study: type[Study]) -> str:
    """The study's own rules of style; "" where it has none."""
    rules = folder_of(study) / RULES
    return rules.read_text(encoding="utf-8") if rules.is_file() else ""


def has_page(study: type[Study]) -> bool:
    """Whether the page has a part of its own for the study."""
    return (folder_of(study) / TEMPLATE).is_file()


def folder_of(study: type[Study]) -> Path:
    return Path(inspect.getfile(study)).parent
