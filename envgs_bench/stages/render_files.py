"""Render files: the pictures of a folder that are scored in place of a method's, found without opening one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from envgs_bench.datasets.formats.names import visible_files

DECODED = (".png", ".jpg", ".jpeg")
SUFFIXES = (*DECODED, ".npy")


@dataclass(frozen=True)
class RendersSettings:
    path: str = ""  # the folder, or nerfbaselines' archive of predictions
    match: str = "name"  # how files find their views: name, or order


def rendered_files(folder: Path) -> list[Path]:
    """The files below the folder that are taken for renders; whatever else lies there is left alone."""
    return [path for path in visible_files(folder) if path.suffix.lower() in SUFFIXES]
