"""The page's templates: the whole page's, and those of parts that come with a template of their own."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..tables.entries import DAGGER
from .sizes import png_size

ASSETS = Path(__file__).parent / "assets"
ORDINALS = {1: "best", 2: "second", 3: "third"}


def rendered(template: Path, shown: Mapping[str, Any], out: Path) -> Markup:
    """A template file with what it shows; whatever comes from a record is escaped.

    Args:
        out: the report's folder, where `sized(path, width)` looks how large a picture is.
    """
    text = template.read_text(encoding="utf-8")
    return Markup(
        _environment().from_string(text).render(shown, sized=lambda path, width=None: _sized(out / path, width))
    )


@cache
def _environment() -> Environment:
    found = Environment(loader=FileSystemLoader(ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    found.globals |= {"dagger": DAGGER, "ordinals": ORDINALS}
    return found


def _sized(picture: Path, shown: int | None) -> Markup:
    """The picture's attributes of size, px; those of `shown` px in width where that is given."""
    width, height = png_size(picture)
    if shown is not None and width:
        width, height = shown, round(height * shown / width)
    return Markup(f'width="{width}" height="{height}"')
