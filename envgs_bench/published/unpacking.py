"""Unpacking: one scene's folder out of an archive of several, into a place that nothing in it can leave."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path, PurePosixPath

from envgs_bench.datasets.errors import DatasetError, listed
from envgs_bench.datasets.progress import report


def unpack_scene(archive: Path, root: Path) -> int:
    """Unpack the folder of the zip file that is called as `root` is, to `root`; returns how many files it holds.

    All of it is there at the end or nothing. Each file is compared with its CRC-32.

    Raises:
        DatasetError: it is no zip file, damaged or encrypted, names a file outside of itself, or has no such folder.
        OSError: it cannot be written, or the disk has no room.
    """
    part = root.with_name(f".{root.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        with zipfile.ZipFile(archive) as content:
            members = _members(content, archive, root.name)
            _require_room(sum(info.file_size for info in members.values()), root)
            for number, (name, info) in enumerate(members.items(), start=1):
                path = part / name
                path.parent.mkdir(parents=True, exist_ok=True)
                with content.open(info) as source, path.open("wb") as target:
                    shutil.copyfileobj(source, target, 1 << 20)
                report("unpacking", number, len(members))
        part.replace(root)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise DatasetError(f"{archive}: cannot be unpacked ({error}); delete it and download it again") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return len(members)


def _members(content: zipfile.ZipFile, archive: Path, folder: str) -> dict[PurePosixPath, zipfile.ZipInfo]:
    """The files below the highest folder of that name, by their paths below it."""
    files = {PurePosixPath(info.filename.replace("\\", "/")): info for info in content.infolist() if not info.is_dir()}
    leaving = [str(path) for path in files if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]]
    if leaving:
        raise DatasetError(f"{archive}: names files outside of itself ({listed(leaving)}); nothing was unpacked")
    places = {place for path in files for place in path.parents if place.name}
    found = sorted((place for place in places if place.name == folder), key=lambda place: (len(place.parts), place))
    if not found:
        raise DatasetError(f"{archive}: holds no folder {folder}, only {listed(sorted(map(str, places)))}")
    return {path.relative_to(found[0]): info for path, info in files.items() if path.is_relative_to(found[0])}


def _require_room(needed: int, root: Path) -> None:
    root.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(root.parent).free
    if needed > free:
        raise DatasetError(f"{root}: needs {needed / 1e9:.1f} GB, and its disk has {free / 1e9:.1f} GB left")
