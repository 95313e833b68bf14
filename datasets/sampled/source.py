"""The data source of sampled scenes: from a seed to a Scene."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..settings import parse_dataset_settings
from ..source import Source
from .settings import SampledSettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 3  # raise it with every change that alters a scene


def load_sampled(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """The scene that the distribution has for a seed: path-traced pictures, exact truth, points, and its attributes.

    Regions are those of `truth.TruthOf`, and of what does not train `covisible`. Training views' normals are an
    estimator's, all others' are exact. The pictures alone are what takes time: they are kept in `cache_dir/pictures`, a
    ZIP a scene, which another machine's cache may be given, where Mitsuba is not needed then.

    Raises:
        DatasetError: an unknown key, a value out of range, or Mitsuba is needed and not installed.
    """
    from ..store.cache import cached_scene  # with torch, which settings are checked without

    choice = parse_dataset_settings(SampledSettings, settings)
    name = choice.name or f"sampled/{choice.seed}"
    own = {"source": "sampled", "version": VERSION, **choice.model_dump(exclude={"name"})}
    if not choice.unseen:
        del own["unseen"]  # pictures that are kept stay those of their scene

    def make() -> Scene:
        from .making import Drawn, make_scene, traced  # which take 1 s to import
        from .pictures import Pictures, archive_name, kept_pictures

        digest = hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()[:12]
        path = Path(cache_dir) / "pictures" / archive_name(own, digest)

        def pictures(scene: Drawn) -> Pictures:
            return kept_pictures(path, len(scene.cameras) + len(scene.unseen_views), lambda: traced(choice, scene))

        return make_scene(choice, name, pictures)

    return cached_scene(cache_dir, name, {**own, "name": name}, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """No file: a sampled scene is made from its settings, which are checked."""
    parse_dataset_settings(SampledSettings, settings)
    return []


SOURCE = Source(load_sampled, files_read, places=True, empty_regions=True)
