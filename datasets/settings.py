"""What a data source raises, and settings that explain what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError


class DatasetError(ValueError):
    """The data cannot be used: the message names the file or key and says what to do."""


class SourceSettings(BaseModel):
    """Base of every source's settings: unknown keys are refused, nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str
    name: str | None = None  # in tables
    free_space: float = 0.0  # nothing is nearer than this to any camera, world units
    bounds: float = 0.0  # half the edge of a cube around the origin that holds the surroundings; 0: unknown


Settings = TypeVar("Settings", bound=SourceSettings)


def parse_settings(model: type[Settings], given: Mapping[str, Any]) -> Settings:
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
                lines.append(f"dataset.{key}={problem['input']!r}: {problem['msg']}")
        raise DatasetError("\n".join(lines)) from error
