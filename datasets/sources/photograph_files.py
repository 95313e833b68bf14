"""Files of photographs: which a capture is made from, and what becomes of those that are not there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import DatasetError, listed
from ..formats.photograph import Photograph
from ..notes import note
from .settings import Missing


def files_of(photographs: Iterable[Photograph]) -> list[Path]:
    """The pictures, and the masks and normals that belong to them."""
    return [
        path
        for photograph in photographs
        for path in (
            photograph.path,
            *photograph.masks.values(),
            *([photograph.normal.path] if photograph.normal else []),
        )
    ]


def refuse_missing(how: Missing, named: int, missing: Sequence[str], source: Path) -> None:
    """Refuse, or else note, that images which `source` names are not there.

    Raises:
        DatasetError: some are missing and the settings do not say to skip them, or all are.
    """
    if not missing:
        return
    text = f"{source}: {len(missing)} of {named} images that it names are not there: {listed(list(missing))}"
    if how == "skip" and len(missing) < named:
        note(f"{text}; left out")
        return
    raise DatasetError(f"{text}; put them back, or name their folder with dataset.images, or set dataset.missing=skip")
