"""Which data sources there are, and how a scene is loaded by its settings."""

from __future__ import annotations

import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envgs_bench.import_path import load_import_path

from .errors import DatasetError
from .formats.names import PICTURES
from .sampled.settings import SampledSettings
from .settings import SceneSettings, SourceSettings, parse_dataset_settings, require_folder
from .source import Source
from .sources.settings import SETTINGS as OF_FILES
from .toy.settings import ToySettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

ADDRESSES = ("obtain", "download", "photographs")  # where data are to be had: nothing that a scene is made from
SETTINGS: dict[str, type[SourceSettings]] = {  # apart from sources: composing a run imports none
    "toy": ToySettings,
    **OF_FILES,
    "sampled": SampledSettings,
}
BUILT_IN = {
    "toy": "envgs_bench.datasets.toy.source:SOURCE",
    **{kind: f"envgs_bench.datasets.sources.{kind}:SOURCE" for kind in OF_FILES},
    "sampled": "envgs_bench.datasets.sampled.source:SOURCE",
}
MISSING = "???"  # Hydra's word for what has to be given


def load_scene(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A scene, made or read as its settings say, then cached.

    Args:
        settings: `kind` picks the source: one of `BUILT_IN`, or an import path "package.module:name" to a `Source`, or
            to its `load` alone. `obtain` says where the data are to be had, for whoever has no folder `root`,
            `download` is the address of their archive, where they have one, and `photographs` says how the folder is
            made of what that holds; the keys of `settings.SceneSettings` hold for every source. The other keys are the
            source's own.
        cache_dir: where sources keep what took them time; made if missing.

    Raises:
        DatasetError: no such kind, a key the source does not have or of a wrong value, or data that cannot be used.
    """
    from .consistency.scenes import check_scene  # with torch, which composing settings does without
    from .placing import placed_scene
    from .regions import check_regions
    from .split import with_validation

    source, stated = _accepted(settings)
    scene = source.load(own_settings(settings), Path(cache_dir))
    if not source.empty_regions:
        check_regions(scene)
    if not source.places:
        scene = placed_scene(scene)
    check_scene(scene, str(settings.get("root") or scene.name))
    scene = with_validation(scene) if stated.validation else replace(scene, val=())
    unit = scene.placement.scale
    free_space, bounds = stated.free_space / unit or scene.free_space, stated.bounds / unit or scene.bounds
    return replace(scene, free_space=free_space, bounds=bounds)


def default_settings(kind: str) -> dict[str, Any]:
    """The settings of a data set of a built-in kind where nobody says otherwise; MISSING what has to be given."""
    known = SETTINGS[kind].model_fields
    fields = {name: MISSING if field.is_required() else field.default for name, field in known.items()}
    return {"name": None, **fields, "kind": kind}


def check_source(settings: Mapping[str, Any]) -> None:
    """Refuse settings that `load_scene` would refuse, as far as that can be told without reading pictures.

    Raises:
        DatasetError: as `load_scene`; of sources of somebody else's only where they cannot be had.
    """
    source, _ = _accepted(settings)
    if source.files_read is None:
        return
    if settings.get("root"):
        require_folder(Path(settings["root"]))
    pictures = [file for file in _read_by(source, settings) if file.suffix.lower() in PICTURES]
    if settings.get("root") and len(pictures) < 2:
        raise DatasetError(f"dataset.root={settings['root']}: {len(pictures)} images, expected at least two, one tests")


def is_cached(settings: Mapping[str, Any], cache_dir: Path) -> bool:
    """Whether `load_scene` would find the scene in the cache, or need not: of sources of somebody else's nobody knows.

    Raises:
        DatasetError: as `load_scene`.
    """
    from .store.cache import NotCached, nothing_made  # with torch, which composing settings does without

    source = source_of(settings["kind"])
    try:
        with nothing_made():
            if source.files_read is not None:
                source.load(own_settings(settings), cache_dir)
    except NotCached:
        return False
    return True


def files_read(settings: Mapping[str, Any]) -> list[Path] | None:
    """The files that `load_scene` makes the scene of these settings from; None where only their source knows.

    That is so for sources of somebody else's, and for data that cannot be used, as loading them will say.
    """
    if not settings.get("root"):
        return None
    try:
        source = source_of(settings["kind"])
        return None if source.files_read is None else _read_by(source, settings)
    except (DatasetError, OSError):
        return None


def _read_by(source: Source, settings: Mapping[str, Any]) -> list[Path]:
    """What the source makes the scene from, as far as it is there."""
    found = source.files_read(own_settings(settings)) if source.files_read else []
    return [path for path in found if path.is_file()]


def own_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a data set's settings that its source is given: without what `load_scene` itself uses."""
    return {key: value for key, value in settings.items() if key not in (*ADDRESSES, *SceneSettings.model_fields)}


def _accepted(settings: Mapping[str, Any]) -> tuple[Source, SceneSettings]:
    """The source, and the settings that hold for every source."""
    kind = settings.get("kind")
    if not isinstance(kind, str):
        raise DatasetError(f"dataset.kind={kind!r}: expected one of {', '.join(BUILT_IN)}")
    source = source_of(kind)
    obtain, root = settings.get("obtain"), settings.get("root")
    if obtain and root and not Path(root).is_dir():
        command = f"`envgs-bench download {settings.get('name')}`, or by hand: " if settings.get("download") else ""
        raise DatasetError(
            f"dataset.root={root}: there is no such folder. Get it: {command}{obtain}. If it lies elsewhere, give "
            "the folder above as data_root=… or once for all as $ENVGS_BENCH_DATA_ROOT, or the folder itself as "
            "dataset.root=…"
        )
    stated = {key: settings[key] for key in SceneSettings.model_fields if key in settings}
    return source, parse_dataset_settings(SceneSettings, stated)


def source_of(kind: str) -> Source:
    """The source of that kind.

    Raises:
        DatasetError: there is none, or it cannot be imported.
    """
    path = BUILT_IN.get(kind, kind)
    if ":" not in path:
        raise DatasetError(
            f"dataset.kind={kind!r} is unknown: expected one of {', '.join(BUILT_IN)}, "
            "or an import path, package.module:name"
        )
    try:
        found = load_import_path(path)
    except ImportError as error:
        raise DatasetError(f"dataset.kind={kind!r} cannot be imported from {path}: {error}") from error
    finally:
        _keep_sigterm()
    return found if isinstance(found, Source) else Source(found)


def _keep_sigterm() -> None:
    """Have SIGTERM do again what it did before pycolmap was imported, which prints a stack trace and aborts instead."""
    handler = signal.getsignal(signal.SIGTERM)
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)
