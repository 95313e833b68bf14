"""Method: what the harness asks of every method, however it draws."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch

from envgs_bench.core import Camera, Rendering, Scene, View


class Method(ABC):
    """A way to learn a scene from views and to draw it from new ones.

    The harness calls `initialize` once, `training_step` for step 1 to `steps`, then `prepare` and `render`; or `load`
    in place of the training. A method gets plain values and knows of no data source and no configuration system.

    Attributes:
        Settings: the method's frozen settings dataclass; every field has a default.
        skipped_steps: training steps that were not applied because a loss or gradient was not finite.
    """

    Settings: ClassVar[type]

    def __init__(self, settings: Any, device: torch.device | str = "cpu", seed: int = 0) -> None:
        self.settings = settings
        self.device = torch.device(device)
        self.generator = torch.Generator().manual_seed(seed)  # on the CPU: the same numbers for every device
        self.skipped_steps = 0

    @abstractmethod
    def initialize(self, scene: Scene, steps: int) -> None:
        """Start from the scene's points; schedules stretch to a run of `steps` steps."""

    @abstractmethod
    def training_step(self, view: View, step: int) -> dict[str, float]:
        """Learn from one training view. `step` counts from 1. Returns the losses, the total as "loss"."""

    @abstractmethod
    def render(self, camera: Camera) -> Rendering:
        """The scene as `camera` sees it, without gradients; `layers` holds a method's named parts."""

    def prepare(self) -> None:  # noqa: B027 (many methods need nothing)
        """Make what rendering needs once, such as acceleration structures. Timed apart from frames."""

    @abstractmethod
    def primitives(self) -> dict[str, int]:
        """Number of primitives of each set, "base" and "env"."""

    @abstractmethod
    def model_bytes(self) -> dict[str, int]:
        """Bytes of each set's parameters stored as float32, under the keys of `primitives`."""

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write what `render` needs into `folder`, made where missing."""

    @abstractmethod
    def load(self, folder: Path) -> None:
        """Read what `save` wrote. Raises FileNotFoundError or ValueError, naming the file."""


def make_settings(settings_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """`values` as an instance of the dataclass `settings_type`.

    Raises:
        ValueError: a key is not one of its fields, or a value has another type than the default; the message lists
            the known keys.
    """
    known = {field.name: field for field in dataclasses.fields(settings_type)}
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ValueError(f"{owner} has no setting {', '.join(unknown)}; its settings are {', '.join(sorted(known))}")
    return settings_type(**{key: _checked(owner, key, value, known[key].default) for key, value in values.items()})


def _checked(owner: str, key: str, value: Any, default: Any) -> Any:
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        expected = type(default).__name__
        raise ValueError(
            f"{owner}: setting {key} is {value!r}, expected a value of type {expected} such as {default!r}"
        )
    return value
