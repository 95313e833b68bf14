"""Drawn charts: a figure as a PNG with a PDF beside it, and how a page names them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

FORMATS = ("png", "pdf")
DPI = 200


@dataclass(frozen=True)
class DrawnChart:
    """A chart that was drawn: its PNG relative to the report; the PDF stands beside it."""

    png: str

    @property
    def pdf(self) -> str:
        return self.png.removesuffix("png") + "pdf"


@dataclass(frozen=True)
class TitledChart(DrawnChart):
    title: str


def write_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write <stem>.png and <stem>.pdf, in a folder that is made where missing; equal figures make equal files."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in FORMATS]
    for path in paths:
        undated = {"CreationDate": None} if path.suffix == ".pdf" else {}
        figure.savefig(path, dpi=DPI, facecolor="white", metadata=undated)
    return paths
