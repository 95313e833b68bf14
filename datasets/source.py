"""Source: what a kind of data set is to the rest of the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # torch and pycolmap, which composing settings does without
    from envgs_bench.core import Scene

    from .formats.colmap_model import Model
    from .formats.photograph import Photograph

Given = Mapping[str, Any]  # a data set's settings, without those that hold for every source


@dataclass(frozen=True)
class Source:
    """A kind of data set; each of its functions raises a DatasetError for settings and data that cannot be used."""

    load: Callable[[Given, Path], Scene]
    """The scene of these settings; what is costly to make is kept in the folder. `val` are those of its training views
    that may validate, as scores are to see them, and still train too."""
    files_read: Callable[[Given], list[Path]] | None = None
    """The files that the scene is made from, by which runs tell whether data have changed; None: only it knows."""
    photographs_of: Callable[[Given, Path], list[Photograph]] | None = None
    """What the views are made from, as they were taken: masks that are exported follow their lenses and names."""
    model_of: Callable[[Given, Path], Model] | None = None
    """Cameras, poses and points of the photographs, where a capture in COLMAP's layout can be made of them."""
    places: bool = False
    """Whether it moves and scales the world itself where that is needed, before anything is float32."""
    empty_regions: bool = False
    """Whether a region may be known to be empty in every view; else that is an error."""
