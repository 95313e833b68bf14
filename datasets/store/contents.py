"""Contents: what files hold, as one hash, without reading again those that did not change."""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..progress import mapped

Stamp = list[int]


def digest_of(files: Iterable[Path], root: Path, cache_dir: Path) -> str:
    """A hash of the paths below `root` and the bytes of these files: not of where they lie or when they changed.

    Each file's hash is remembered in the cache with its size, inode and times. Whoever changes a file's contents also
    changes its ctime, which no program can set back: files that look the same are the same, and are not read again.
    """
    paths = sorted(set(files))
    memory = cache_dir / "digests" / f"{hashlib.sha256(str(root.resolve()).encode()).hexdigest()[:16]}.json"
    known = remembered(memory)
    stamps = {path: _stamp(path) for path in paths}
    names = {path: os.path.relpath(path, root) for path in paths}
    changed = [path for path in paths if known.get(names[path], [None])[0] != stamps[path]]
    for path, digest in zip(changed, mapped("checking files", _hash, changed), strict=True):
        known[names[path]] = [stamps[path], digest]
    if changed:
        remember(memory, known)
    text = json.dumps([[names[path], known[names[path]][1]] for path in paths])
    return hashlib.sha256(text.encode()).hexdigest()


def files_in(folders: Iterable[Path]) -> list[Path]:
    """Every file below these folders."""
    return [path for folder in folders for path in folder.rglob("*") if path.is_file()]


def _stamp(path: Path) -> Stamp:
    status = path.stat()
    return [status.st_size, status.st_ino, status.st_mtime_ns, status.st_ctime_ns]


def _hash(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def remembered(memory: Path) -> dict[str, list[Any]]:
    """A file's name -> what it was known by, and its hash; without what else a damaged memory may hold."""
    try:
        content = json.loads(memory.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    pairs = content.items() if isinstance(content, dict) else ()
    return {name: pair for name, pair in pairs if isinstance(pair, list) and len(pair) == 2}


def remember(memory: Path, known: dict[str, list[Any]]) -> None:
    """Keep `known` for `remembered`. Where nothing can be written, it is found out again the next time."""
    part = memory.with_name(f"{memory.stem}-{uuid.uuid4().hex}.part")
    try:
        memory.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(known), encoding="utf-8")
        os.replace(part, memory)
    except OSError:
        pass
