"""The toy data source: from settings to a Scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..settings import parse_dataset_settings
from ..source import Source
from .settings import ToySettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 11  # raise it with every change that alters a scene


def load_toy(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A toy scene: pictures, exact normals and depth, the regions `reflective` and `near_field`, and a point cloud.

    Where there is glass, the region `transmissive` too; of what does not train `covisible`. With `normal_noise` the
    training views' normals are an estimator's (`normal_noise.noisy_normals`); those of test and validation views, which
    scores refer to, are exact in any case.

    Raises:
        DatasetError: an unknown key, or a value out of range.
    """
    choice = parse_dataset_settings(ToySettings, settings)
    unsaid = {"tracer"} if choice.tracer == "cpu" else set()  # scenes that are cached stay those of their settings
    name = choice.name or f"toy/{choice.scene}"
    from ..store.cache import cached_scene  # with torch, which settings are checked without

    key = {"source": "toy", "version": VERSION, **choice.model_dump(exclude=unsaid), "name": name}

    def make() -> Scene:
        from .making import make_scene  # which takes 1 s to import: most runs find their scene in the cache

        return make_scene(choice, name)

    return cached_scene(cache_dir, name, key, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """No file: a toy scene is made from its settings, which are checked."""
    parse_dataset_settings(ToySettings, settings)
    return []


SOURCE = Source(load_toy, files_read, places=True, empty_regions=True)
