"""Which run is this: a hash of what determines the result."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from envgs_bench.datasets.registry import ADDRESSES, files_read
from envgs_bench.datasets.store.contents import digest_of, files_in
from envgs_bench.methods.registry import installed_methods
from envgs_bench.metrics import WeightsUnavailable, find_weights
from envgs_bench.programs.recipe import parse_choice
from envgs_bench.programs.work import commit_of
from envgs_bench.records import EXTERNAL, RENDERS
from envgs_bench.settings import PATH_KEYS, RunSettings
from envgs_bench.stages.render_files import rendered_files

from .source_fingerprint import SOURCES, source_fingerprint, source_fingerprints

# The rooms whose code can change a result: all that `stages.execution.execute` does lies in them.
RESULT_CODE = ("core", "datasets", "diagnosis", "methods", "metrics", "programs", "stages")


def run_id(settings: RunSettings, device: str) -> str:
    """`seed<seed>-<hash8>`: equal where all that determines the result is.

    That is method, data, perturbation, repair, budget, steps, seed, protocol, views, timing, device and code. Of data
    the names and contents of the files that are read count, not where they lie: a corrected data set is a new run, a
    moved one or one with a README beside its photographs is not. VGG-16's weights count, which both a loss and a metric
    need: a run without them is run again once they are there. What changes no result does not count: folders, gates,
    force, retry, the limits of time and memory, when snapshots are saved.
    """
    determining = {
        "method": [settings.method.name, settings.method.kind, _method(settings)],
        "dataset": _dataset(settings),
        "perturb": settings.perturb.model_dump() if settings.perturb else None,
        "repair": settings.repair,
        "budget": settings.budget.model_dump() if settings.budget else None,
        "steps": settings.steps,
        "seed": settings.seed,
        "protocol": settings.protocol,
        "score_on": settings.score_on,
        "timing": settings.timing.model_dump(),
        "device": device,
        "vgg16": _has_vgg16(),
        "code": code_version(settings.cache_dir),
        "extensions": [_extension_hash(path) for path in _extensions(settings)],
    }
    digest = hashlib.sha256(json.dumps(determining, sort_keys=True, default=str).encode()).hexdigest()
    return f"seed{settings.seed}-{digest[:8]}"


@cache
def code_version(cache_dir: Path) -> str:
    """A hash of what the sources in RESULT_CODE mean: neither comments count nor in which file of a room code lies.

    Python finds a module by its name, and so do its imports, which count: code that is moved and imported from its new
    place is another code all the same. C++ files are included by their names, which count too.

    Args:
        cache_dir: where it is kept what each file means.
    """
    rooms = {path: room for room in RESULT_CODE for path in _location(room).rglob("*") if path.suffix in SOURCES}
    here = hashlib.sha256(str(Path(__file__)).encode()).hexdigest()[:16]
    fingerprints = source_fingerprints(list(rooms), cache_dir / "digests" / f"code-{here}.json")
    parts = []
    for (path, room), fingerprint in zip(rooms.items(), fingerprints, strict=True):
        name = "" if path.suffix == ".py" else path.name
        parts.append(f"{room}/{name}\0".encode() + fingerprint)
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
        digest.update(source_fingerprint(file) if file.is_file() else b"")
    return digest.hexdigest()


def _with_fingerprints(node: dict[str, Any], cache_dir: Path) -> dict[str, Any]:
    return {
        key: _fingerprint(Path(value), cache_dir) if key in PATH_KEYS and value else value
        for key, value in node.items()
    }


def _fingerprint(root: Path, cache_dir: Path, files: Sequence[Path] | None = None) -> str:
    """A hash of these files' names and contents, or else of all that lies at `root`; the path where nothing does.

    Contents are read once: see `digest_of`.
    """
    if root.is_file():
        return digest_of([root], root.parent, cache_dir)
    if not root.is_dir():
        return str(root)
    found = files_in([root]) if files is None else [path for path in files if path.is_file()]
    return digest_of(found, root, cache_dir)


def _dataset(settings: RunSettings) -> dict[str, Any]:
    """The data set's settings, with the contents of the files that are read in place of where they lie."""
    node = {key: value for key, value in settings.dataset.items() if key not in ADDRESSES}
    given = _with_fingerprints({key: value for key, value in node.items() if key != "root"}, settings.cache_dir)
    if node.get("root"):
        given["root"] = _fingerprint(Path(node["root"]), settings.cache_dir, files_read(node))
    return given


def data_hash(settings: RunSettings) -> str | None:
    """A hash of the files that the data set is made from, wherever they lie; None where there are none, or no more."""
    root = settings.dataset.get("root")
    try:
        if not root or not Path(root).is_dir():
            return None
        return _fingerprint(Path(root), settings.cache_dir, files_read(settings.dataset))[:16]
    except OSError:
        return None


def _method(settings: RunSettings) -> dict[str, Any]:
    """The method's settings; of a folder of renders, the pictures that are scored count.

    Of another program what it is told counts, and the commit that its folder has checked out, not where that lies.
    """
    given = settings.method.settings
    if settings.method.kind == EXTERNAL:
        told = parse_choice(given).recipe.model_dump(exclude={"name", "page", "commit", "licence", "tried"})
        return {**given, "recipe": told, "home": commit_of(given.get("home"))}
    if settings.method.kind != RENDERS or not given.get("path"):
        return _with_fingerprints(given, settings.cache_dir)
    root = Path(given["path"])
    files = rendered_files(root) if root.is_dir() else None
    return {**given, "path": _fingerprint(root, settings.cache_dir, files)}
