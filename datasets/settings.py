"""Settings of data sources, which explain what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo

from .errors import DatasetError

Length = Annotated[float, Field(ge=0, allow_inf_nan=False)]  # world units; 0 where unknown
Frame = Literal["world", "camera", "opengl"]  # camera: x right, y down, z forward; opengl: x right, y up, z backward
Edge = Annotated[int, Field(ge=16)]  # pixels, of pictures that are made; metrics take no fewer
MatcherName = Literal["sift", "lightglue"]
Matching = Literal["exhaustive", "sequential"]
TALLEST = 5  # × its width, of a picture that is made: its angle is that of its width, and more would pass 150°
MIN_IMAGES = 3  # that structure from motion must place


class SceneSettings(BaseModel):
    """What holds for a scene from any source: `load_scene` itself uses these settings, sources are not given them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    validation: bool = False  # every eighth training view, from the first, is taken out: to choose settings by
    free_space: Length = 0.0  # nothing is nearer than this to any camera
    bounds: Length = 0.0  # half the edge of a cube around the world's origin that holds the surroundings


class SourceSettings(SceneSettings):
    """Base of every source's settings: unknown keys are refused, nothing changes after reading."""

    kind: str
    name: str | None = None  # in tables


def not_too_tall(height: int, info: ValidationInfo) -> int:
    """`height`, the setting after `width`; raises ValueError where no camera takes pictures of that shape."""
    width = info.data.get("width")
    if width is not None and height > TALLEST * width:
        raise ValueError(
            f"expected at most {TALLEST} × dataset.width={width}; set both, as dataset.width=64 dataset.height=48"
        )
    return height


Settings = TypeVar("Settings", bound=SceneSettings)


def parse_dataset_settings(model: type[Settings], given: Mapping[str, Any]) -> Settings:
    """`given` as the source's settings.

    Raises:
        DatasetError: keys that the source does not have, lacks, or that hold a wrong value; all of them are named.
    """
    try:
        return model.model_validate(dict(given))
    except ValidationError as error:
        keys = ", ".join(model.model_fields)
        lines = []
        for problem in error.errors():
            key = ".".join(map(str, problem["loc"]))
            if problem["type"] == "extra_forbidden":
                lines.append(f"dataset.{key}: there is no such key; the keys are {keys}")
            elif problem["type"] == "missing":
                lines.append(f"dataset.{key}: is missing; give it as dataset.{key}=…")
            else:
                lines.append(f"dataset.{key}={problem['input']!r}: {problem['msg'].removeprefix('Value error, ')}")
        raise DatasetError("\n".join(lines)) from error


def require_folder(root: Path) -> None:
    """Raise a DatasetError where `root`, the setting, is no folder."""
    if root.is_file():
        raise DatasetError(f"dataset.root={root}: is a file; unpack it and give the folder")
    if not root.is_dir():
        raise DatasetError(f"dataset.root={root}: there is no such folder")
