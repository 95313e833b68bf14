"""Which run is this: a hash of what determines the result."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from functools import cache
from pathlib import Path
from typing import Any

from envgs_bench.datasets.registry import files_read
from envgs_bench.datasets.store.contents import digest_of, files_in
from envgs_bench.methods.registry import installed_methods
from envgs_bench.metrics import WeightsUnavailable, find_weights
from envgs_bench.records import RENDERS
from envgs_bench.settings import PATH_KEYS, RunSettings

from .meaning import SOURCES, meaning_of

# The rooms whose code can change a result: all that `stages.execution.execute` does lies in them.
RESULT_CODE = ("core", "datasets", "methods", "metrics", "stages")
COMPRESSED = (".png", ".jpg", ".jpeg", ".webp")  # files that other pixels make another size


def run_id(settings: RunSettings, device: str) -> str:
    """`seed<seed>-<hash8>`: equal where method, data, steps, seed, protocol, views, timing, device and code are equal.

    Where data lie does not count, what is read there does (names and contents of the files that the data source makes
    its scene from; of renders the content): a corrected data set is a new run, a moved one is not, nor is one with a
    file more that nobody reads. VGG-16's weights count, which both a loss and a metric need: a run without them is run
    again once they are there. What changes no result does not count: folders, force, retry_failed, the limits of time
    and memory, when snapshots are saved.
    """
    cache_dir = settings.cache_dir
    dataset = {key: value for key, value in settings.dataset.items() if key != "obtain"}
    determining = {
        "method": [settings.method.name, settings.method.kind, _with_fingerprints(settings.method.settings, cache_dir)],
        "dataset": _with_fingerprints(dataset, cache_dir, _files_read(settings)),
        "steps": settings.steps,
        "seed": settings.seed,
        "protocol": settings.protocol,
        "score_on": settings.score_on,
        "timing": settings.timing.model_dump(),
        "device": device,
        "vgg16": _has_vgg16(),
        "code": code_version(),
        "renders": _content(settings.method.settings.get("path")) if settings.method.kind == RENDERS else None,
        "extensions": [_extension_hash(path) for path in _extensions(settings)],
    }
    digest = hashlib.sha256(json.dumps(determining, sort_keys=True, default=str).encode()).hexdigest()
    return f"seed{settings.seed}-{digest[:8]}"


@cache
def code_version() -> str:
    """A hash of what the sources in RESULT_CODE mean: neither comments count nor in which file of a room code lies.

    Python finds a module by its name, and so do its imports, which count: code that is moved and imported from its new
    place is another code all the same. C++ files are included by their names, which count too.
    """
    parts = []
    for room in RESULT_CODE:
        for path in _location(room).rglob("*"):
            if path.suffix in SOURCES:
                name = "" if path.suffix == ".py" else path.name
                parts.append(f"{room}/{name}\0".encode() + meaning_of(path))
    return hashlib.sha256(b"".join(sorted(parts))).hexdigest()


@cache
def _has_vgg16() -> bool:
    try:
        find_weights()
    except WeightsUnavailable:
        return False
    return True


def _location(room: str) -> Path:
    """Methods, datasets and metrics may lie outside of the package's folder in an editable install: ask the imports."""
    spec = importlib.util.find_spec(f"envgs_bench.{room}")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def _extensions(settings: RunSettings) -> tuple[str, ...]:
    """What a run may take from somebody else's code: names or import paths."""
    return settings.method.kind, settings.dataset["kind"], settings.dataset.get("normal_estimator") or ""


def _extension_hash(kind: str) -> str | None:
    """A hash of the Python sources of the package that a method or data source of somebody else's comes from.

    `kind` is an import path "package.module:name" or the name of an entry point; None for what this package brings.
    """
    installed = installed_methods()
    path = installed[kind].value if kind in installed else kind
    if ":" not in path:
        return None
    try:
        spec = importlib.util.find_spec(path.partition(":")[0].partition(".")[0])
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return None  # loading it will say so
    folders = [Path(folder) for folder in spec.submodule_search_locations or ()]
    files = sorted(file for folder in folders for file in folder.rglob("*.py")) or [Path(spec.origin or "")]
    digest = hashlib.sha256()
    for file in files:
        digest.update(meaning_of(file) if file.is_file() else b"")
    return digest.hexdigest()


def _files_read(settings: RunSettings) -> list[Path] | None:
    """The files that the data set's scene is made from, None of a source that does not say so, or cannot read them."""
    if not settings.dataset.get("root"):
        return None
    try:
        return files_read(settings.dataset, settings.cache_dir)
    except Exception:
        return None  # as the run itself will say


def _with_fingerprints(node: dict[str, Any], cache_dir: Path, files: list[Path] | None = None) -> dict[str, Any]:
    return {
        key: _fingerprint(Path(value), cache_dir, files) if key in PATH_KEYS and value else value
        for key, value in node.items()
    }


def _fingerprint(root: Path, cache_dir: Path, files: list[Path] | None) -> list[Any] | str:
    """What lies at `root`, of all that or of `files` alone, or the path itself where there is nothing.

    Where it is not known which files are read, those of compressed pictures count by name and size only. Hashes are
    remembered in the cache.
    """
    if root.is_file():
        return [(root.name, root.stat().st_size)]
    if not root.is_dir():
        return str(root)
    if files is not None:
        return [digest_of(files, root, cache_dir)]
    below = sorted(files_in([root]))
    pictures = [path for path in below if path.suffix.lower() in COMPRESSED]
    sizes = [(str(path.relative_to(root)), path.stat().st_size) for path in pictures]
    return [*sizes, digest_of(set(below) - set(pictures), root, cache_dir)]


def _content(root: str | None) -> str | None:
    """A hash of all files below `root`: pictures drawn again have the names, and may have the sizes, that they had."""
    if root is None or not Path(root).is_dir():
        return root
    digest = hashlib.sha256()
    for path in sorted(path for path in Path(root).rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
