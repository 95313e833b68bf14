"""Kept models: what takes structure from motion minutes to make, in a folder beside the sums of its files."""

from __future__ import annotations

import json
import shutil
import uuid
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pycolmap

from ..errors import DatasetError, unwritable
from ..formats.colmap_model import Model

CHECKSUMS = "checksums.json"  # of the model's files, beside them


def kept_model(folder: Path, make: Callable[[Path], pycolmap.Reconstruction]) -> Model:
    """The model in `folder`, made unless it is there as it was written.

    Args:
        make: given a new folder of its own to work in, which is deleted.

    Raises:
        DatasetError: it has to be made, and nothing can be written there.
    """
    damaged = folder.is_dir()
    if damaged and _checksums(folder) == _remembered(folder):
        return Model(folder)
    work = folder.with_name(f"{folder.name}-{uuid.uuid4().hex}.part")
    try:
        work.mkdir(parents=True)
    except OSError as error:
        raise DatasetError(unwritable(folder.parent, error, "the model of these photographs", "it")) from error
    try:
        if damaged:
            warnings.warn(f"{folder} is damaged: it is not what was written; it is made again", stacklevel=3)
            shutil.rmtree(folder)
        with _quiet():
            model = make(work)
        (work / "model").mkdir()
        model.write_binary(str(work / "model"))
        (work / "model" / CHECKSUMS).write_text(json.dumps(_checksums(work / "model")), encoding="utf-8")
        try:
            (work / "model").rename(folder)
        except OSError:
            if not folder.is_dir():  # else another process has made it meanwhile
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return Model(folder)


def _checksums(folder: Path) -> dict[str, int]:
    """The CRC-32 of each of the model's files."""
    return {path.name: zlib.crc32(path.read_bytes()) for path in sorted(folder.glob("*.bin")) if path.is_file()}


def _remembered(folder: Path) -> Any:
    try:
        return json.loads((folder / CHECKSUMS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


@contextmanager
def _quiet() -> Iterator[None]:
    """pycolmap says every step it takes; here only its errors are of interest."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
