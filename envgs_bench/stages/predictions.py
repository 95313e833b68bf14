"""Predictions: nerfbaselines' archive of pictures, taken for a folder of renders.

A .tar.gz, a .zip or a folder with `info.json`, `color/<view>.png` and, for whoever scores them there, `gt-color/`.
"""

from __future__ import annotations

import shutil
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

INFO, COLOR = "info.json", "color"
ENDINGS = (".tar.gz", ".tgz", ".zip")
MOST_BYTES = 20_000_000_000  # of an archive's pictures


class PredictionsError(ValueError):
    """An archive that cannot be read; the message names it."""


def is_archive(path: Path) -> bool:
    """Whether the path's name is that of an archive of predictions."""
    return path.name.lower().endswith(ENDINGS)


@contextmanager
def rendered_folder(path: Path) -> Iterator[Path]:
    """The folder with the pictures: `path` itself, its `color` where it is a folder of predictions, or an archive's.

    Raises:
        PredictionsError: no readable archive, or one without pictures in `color`.
    """
    if path.is_dir():
        yield path / COLOR if (path / INFO).is_file() and (path / COLOR).is_dir() else path
        return
    if not path.is_file() or not is_archive(path):
        yield path  # whoever takes a folder says that there is none
        return
    with tempfile.TemporaryDirectory(prefix="envgs-bench-predictions-") as folder:
        try:
            found = _unpack(path, Path(folder))
        except (tarfile.TarError, zipfile.BadZipFile, EOFError, OSError, RuntimeError) as error:
            raise PredictionsError(f"{path}: is no readable archive of predictions ({error})") from error
        if not found:
            raise PredictionsError(f"{path}: has no pictures in {COLOR}/, expected an archive of nerfbaselines")
        yield Path(folder)


def _unpack(path: Path, folder: Path) -> int:
    """Write the files below `color/`, and nothing else, into the folder; how many there are."""
    count = 0
    room = MOST_BYTES
    for name, size, stream in _members(path):
        parts = PurePosixPath(name).parts
        if parts[:1] != (COLOR,) or len(parts) < 2 or ".." in parts:
            continue
        room -= size
        if room < 0:
            raise RuntimeError(f"its pictures take more than {MOST_BYTES:,} bytes")
        target = folder.joinpath(*parts[1:])
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("wb") as file:
            shutil.copyfileobj(stream, file)
        count += 1
    return count


def _members(path: Path) -> Iterator[tuple[str, int, IO[bytes]]]:
    """Name, size and content of each file in the archive."""
    if path.name.lower().endswith(".zip"):
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if not entry.is_dir():
                    with archive.open(entry) as stream:
                        yield entry.filename, entry.file_size, stream
        return
    with tarfile.open(path, "r:gz") as members:
        for member in members:
            content = members.extractfile(member) if member.isfile() else None
            if content is not None:
                yield member.name.removeprefix("./"), member.size, content
