"""Method: what the harness asks of every method, however it draws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, View
from envgs_bench.parts import MethodCard


@dataclass(frozen=True)
class Budget:
    """The most that a model may have; None where there is no such limit.

    Attributes:
        primitives: of all sets together.
        mb: 10⁶ bytes of all that is trained, as float32.
    """

    primitives: int | None = None
    mb: float | None = None


@dataclass(frozen=True)
class Needs:
    """What a method asks of the harness before `initialize`.

    Attributes:
        perceptual: which perceptual loss it trains with, a key of `envgs_bench.metrics.PERCEPTUAL_LOSSES`; None: none.
        lpips: whether it looks at its own pictures of training views by LPIPS, the loss of that name.
        agreed_normals: whether it learns from normals in agreement: the harness then gives `Scene.normals`.
        given: what it uses of the data besides photographs, poses and points, where these have it: GIVEN's keys.
        clearance: nothing may be nearer to a camera, world units, as it would not be drawn.
    """

    perceptual: str | None = None
    lpips: bool = False
    agreed_normals: bool = False
    given: tuple[str, ...] = ()
    clearance: float = 0.0


class Monitor:
    """What the harness may look at while a method trains, now and then; each says nothing unless overridden."""

    def last_maps(self) -> Mapping[str, Tensor]:
        """What the last training step drew that shows whether the model is sound, [H, W] by name, without gradients.

        `envgs_bench.parts.ALPHA` and, of a method that blends reflections, BETA.
        """
        return {}

    def degenerate(self) -> Mapping[str, float | Tensor]:
        """The share of each set's primitives, in [0, 1] by the set's name, that are elongated without bound."""
        return {}

    def at_size_limit(self) -> Mapping[str, int]:
        """The sets that are about as large as the method's settings let them be, and how large that is.

        Not what a budget asks for, nor what the method finds a scene to need.
        """
        return {}

    def non_finite_gradients(self) -> list[str]:
        """Parameters whose gradients were not finite in any of the last steps, by name, each call's since the last.

        The harness asks where steps were skipped.
        """
        return []

    def prunes(self, step: int) -> bool:
        """Whether the method removes, right after this training step, what its pictures were found to do without.

        A set may then lose most of itself, and the harness does not warn of it.
        """
        return False

    def reflected(self, origins: Tensor, directions: Tensor) -> Tensor | None:
        """What reflected rays would see, [N, 3] sRGB without gradients, once the method is prepared.

        The harness compares two seeds' models by it. None of a method that traces no rays of its own.

        Args:
            origins, directions: [N, 3] in the world frame, on the method's device; directions have unit length.
        """
        return None


class Method(ABC):
    """A way to learn a scene from views and to draw it from new ones.

    The harness calls `initialize` once, `training_step` for step 1 to `steps`, then `prepare` and `render`; or `load`
    in place of the training; or `resume` in place of `initialize`, and then the steps that an interruption left out.
    Where a run is logged, it calls `prepare` and `render` between steps too, which must not change what is learned. Of
    a run with a budget it calls `limit` before all of these. One of frames it keeps itself: it times `picture`, and
    calls `limit` again. A method gets plain values and knows of no data source and
    no configuration system.

    Attributes:
        Settings: the method's frozen settings dataclass; every field has a default.
        card: what reports show of it; None where they are to find a name and a color themselves.
        skipped_steps: training steps that were not applied because a loss or gradient was not finite; a number, or a
            tensor of one.
        perceptual: the perceptual losses that `needs` names, by name: of two [H, W, 3] images in [0, 1], (image,
            target) -> scalar, differentiable in the first. The harness adds them before `initialize` where the
            network's weights can be had; where they cannot, the method does without.
        dropped_losses: a loss that the settings ask for and that cannot be computed here -> why, a loss of
            `envgs_bench.parts.LOSSES` under its key there; complete once `initialize` is done. The harness adds the
            perceptual loss where it has none to offer, the method what the scene lacks.
        notes: what the method made of the scene's normals, and what a pilot run on the scene has shown to be needed or
            not, complete once `initialize` is done; later, how many primitives prunings left. A sentence each.
    """

    Settings: ClassVar[type]
    card: ClassVar[MethodCard | None] = None
    skipped_steps: int | Tensor = 0

    def __init__(self, settings: Any, device: torch.device | str = "cpu", seed: int = 0) -> None:
        self.settings = settings
        self.device = torch.device(device)
        self.generator = torch.Generator().manual_seed(seed)  # on the CPU: the same numbers for every device
        self.perceptual: dict[str, Callable[[Tensor, Tensor], Tensor]] = {}
        self.dropped_losses: dict[str, str] = {}
        self.notes: list[str] = []

    def training_steps(self, steps: int) -> int:
        """How many steps a run that is given `steps` trains; the harness asks before `initialize`, most take all."""
        return steps

    @property
    def needs(self) -> Needs:
        """What these settings need of the harness; most methods need nothing."""
        return Needs()

    @property
    def monitor(self) -> Monitor | None:
        """What the harness may look at between steps; None of a method that shows nothing of itself."""
        return None

    def limit(self, budget: Budget) -> None:
        """Be within `budget` from now on, at every step and picture: called before `initialize`, or never.

        Where frames have a limit, it is called again between steps and after the last one, with as many `primitives`
        as timed frames leave room for, fewer or more than before.

        Raises:
            ValueError: the method keeps to no budget, or needs more than that.
        """
        raise ValueError(f"{type(self).__name__} keeps to no budget: run it without, or give it a method `limit`")

    @abstractmethod
    def initialize(self, scene: Scene, steps: int) -> None:
        """Start from the scene's points; schedules stretch to a run of `steps` steps."""

    @abstractmethod
    def training_step(self, view: View, step: int) -> Mapping[str, float | Tensor]:
        """Learn from one training view. `step` counts from 1. Returns the losses, the total as "loss".

        A loss is a number, or a tensor of one: the harness reads several steps' at once, so that a step need not wait
        for the device. A step whose loss or gradient is not finite is not applied, and counted in `skipped_steps`.
        """

    def settle(self) -> None:  # noqa: B027 (most methods leave nothing under way)
        """Finish what the last steps left under way; the harness calls it before it reads what they returned."""

    @abstractmethod
    def render(self, camera: Camera) -> Rendering:
        """The scene as `camera` sees it, [H, W, …] float32 without gradients.

        `layers` holds the picture's parts by name, [H, W], [H, W, 1] or [H, W, 3], shown clamped to [0, 1]: what the
        base, the reflection and β show goes by the names of `envgs_bench.parts.LAYERS`, anything else by one of the
        method's own; "normal", "depth" and "error" are added by the harness.
        """

    def picture(self, camera: Camera) -> Tensor:
        """`render`'s color [H, W, 3] alone, to rounding: what is timed. Overridden where less does for it."""
        return self.render(camera).color

    def prepare(self) -> None:  # noqa: B027 (many methods need nothing)
        """Make what rendering needs once, such as acceleration structures. Timed apart from frames."""

    @abstractmethod
    def primitives(self) -> dict[str, int]:
        """Number of primitives of each of `envgs_bench.parts.SETS`, 0 of a missing set; after `initialize`."""

    @abstractmethod
    def model_bytes(self) -> dict[str, int]:
        """Bytes of each set's parameters as float32 in memory, under the same keys: no file's size."""

    def training_state(self) -> dict[str, Any] | None:
        """All that the next training step depends on, after any step; None of a method that cannot go on from it.

        Tensors, numbers, strings, None, and lists and dictionaries of them: parameters, the optimizers' moments,
        `generator`, `skipped_steps`, and what the monitor has not told yet. What `initialize` makes of the
        same scene and settings need not be in it.
        """
        return None

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        """In place of `initialize`: become what `training_state` returned, tensors on the CPU, of the same settings.

        Training then goes on bitwise as it would have without the interruption, where the device is a CPU.
        """
        raise NotImplementedError(f"{type(self).__name__} has a training_state and no resume")

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write what `render` needs into `folder`, made where missing."""

    @abstractmethod
    def load(self, folder: Path) -> None:
        """Read what `save` wrote. Raises FileNotFoundError or ValueError, naming the file."""
