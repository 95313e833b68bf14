"""Drawn charts: figures as files, in the formats that were asked for, and how a page names them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG, PDF = "png", "pdf"
DPI = 200


@dataclass(frozen=True)
class DrawnChart:
    """A chart that was drawn. Paths are relative to the report.

    Attributes:
        width: on a page, pixels; None leaves it to the page.
    """

    png: str
    title: str
    pdf: str | None = None
    width: int | None = None


@dataclass(frozen=True)
class Canvas:
    """Where a report's charts go: its folder, and whether PDFs are wanted beside the PNGs."""

    out: Path
    pdf: bool = False

    @property
    def fonts(self) -> list[str]:
        """The families that charts ask for: for a PDF a small font, whose glyphs are faster to embed."""
        from .chart_font import FAMILY, chart_fonts  # which is slow to make

        return chart_fonts() if self.pdf else [FAMILY]

    def write(self, figure: Figure, stem: str, title: str = "", width: int | None = None) -> DrawnChart:
        """Write the figure as `<stem>.png` below the report's folder."""
        write_figure(figure, self.out / stem, (PNG, PDF) if self.pdf else (PNG,))
        return DrawnChart(f"{stem}.{PNG}", title, f"{stem}.{PDF}" if self.pdf else None, width)


def write_figure(figure: Figure, stem: Path, formats: Sequence[str] = (PNG, PDF)) -> list[Path]:
    """Write <stem>.png and <stem>.pdf, in a folder that is made where missing; equal figures make equal files."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    for path in paths:
        undated = {"CreationDate": None} if path.suffix == f".{PDF}" else {}
        figure.savefig(path, dpi=DPI, facecolor="white", metadata=undated)
    return paths
