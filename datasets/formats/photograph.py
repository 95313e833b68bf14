"""Photographs: pictures on disk with their cameras, before any pixel is read; what files of poses are read into."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from .names import composed, stem_of
from .normal_maps import NormalMap

LONGEST_EDGE = 100_000  # pixels of a picture; a camera that has more is a mistake


@dataclass(frozen=True)
class Photograph:
    """One picture with a pose, and the files that belong to it."""

    name: str  # as the data name it: a path, unique among the photographs
    path: Path
    camera: pycolmap.Camera  # may be distorted; has the size of the file once fitted
    camera_id: str  # photographs of one camera have one size
    world_to_camera: NDArray[np.float64]  # [4, 4]
    masks: dict[str, Path] = field(default_factory=dict)  # by region
    normal: NormalMap | None = None
    turned: bool = False  # EXIF's orientation is to be applied
    gains: tuple[float, float, float] | None = None  # a channel, that its bytes are multiplied by

    @property
    def view_name(self) -> str:
        """The name without its extension, in one piece: `left/1.jpg` is the view `left_1`."""
        return composed(stem_of(self.name)).replace("/", "_")
