"""Docstrings as Sphinx reads them: what is no markup in ours is none there."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

CODE = re.compile(r"(`[^`]*`)")


def plain(line: str) -> str:
    """The line with the marks escaped that reStructuredText would read: | * and _ outside of code."""
    parts = CODE.split(line)
    return "".join(f"`{part}`" if part.startswith("`") else re.sub(r"([|*]|_\b)", r"\\\1", part) for part in parts)


def escape(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Change a docstring's lines in place, those of its examples not."""
    lines[:] = [line if line.startswith("    ") or line.startswith(":") else plain(line) for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", escape, priority=900)
    return {"parallel_read_safe": True}
