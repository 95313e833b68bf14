"""Course: one training from its start to its end, with stops at which the clock stands still."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.methods.method import Method
from envgs_bench.metrics.psnr import psnr
from envgs_bench.stages.execution import scene_for
from envgs_bench.stages.training import shuffled

# Steps of a whole training that is thrown away: what is compiled or imported at first use is then there. Kernels of a
# GPU differ by SH degree, which grows in the course of a training.
WARM_UP_STEPS = {"cuda": 100, "cpu": 3}


class Trainee(Protocol):
    """Whatever is trained on whole images, one a step; `len` is the number of its primitives."""

    def __len__(self) -> int: ...

    def start(self, scene: Scene, steps: int) -> None:
        """Begin a training of so many steps anew."""

    def training_step(self, view: View, step: int) -> object:
        """Step number `step`, from 1."""

    def settle(self) -> None:
        """Finish what the last steps left under way."""

    def picture(self, camera: Camera) -> Tensor:
        """[H, W, 3] without gradients; may be outside [0, 1]."""


class MethodTraining:
    """A method of ours as a Trainee."""

    def __init__(self, method: Method) -> None:
        self.method = method

    def __len__(self) -> int:
        return sum(self.method.primitives().values())

    def start(self, scene: Scene, steps: int) -> None:
        self.method.initialize(scene_for(self.method, Diagnosis(scene, self.method.device)), steps)

    def training_step(self, view: View, step: int) -> object:
        return self.method.training_step(view, step)

    def settle(self) -> None:
        self.method.settle()

    def picture(self, camera: Camera) -> Tensor:
        return self.method.picture(camera)


@dataclass(frozen=True)
class Stops:
    """When a training stops to be looked at; it always does at its end."""

    steps: Sequence[int] = ()  # after which
    seconds: Sequence[float] = ()  # of training, after the step in which they end


def course(
    trainee: Trainee, scene: Scene, steps: int, seed: int, device: str, stops: Stops = Stops()
) -> Iterator[tuple[int, float]]:
    """Train on the scene's training views in a random order; (steps, seconds so far) at each stop.

    The seconds are those of `start` and of the steps, work on the device included. Until the next stop is asked for
    they do not go on: what the caller does meanwhile costs nothing.
    """
    torch.manual_seed(seed)  # gsplat has no generator of its own
    due_steps, due_seconds = set(stops.steps) | {steps}, sorted(stops.seconds)
    looked = 0.0
    began = time.perf_counter()
    trainee.start(scene, steps)
    for step, view in enumerate(shuffled(scene.train, steps, seed), 1):
        trainee.training_step(view, step)
        seconds = time.perf_counter() - began - looked
        late = [due for due in due_seconds if due <= seconds]
        if step not in due_steps and not late:
            continue
        del due_seconds[: len(late)]
        trainee.settle()
        seconds = _synchronized(device) - began - looked
        yield step, seconds
        looked = time.perf_counter() - began - seconds


def warm_up(trainee: Trainee, scene: Scene, seed: int, device: str) -> None:
    """Train for a few steps, for nothing."""
    for _ in course(trainee, scene, WARM_UP_STEPS[torch.device(device).type], seed, device):
        pass


@torch.no_grad()
def mean_psnr(picture: Callable[[Camera], Tensor], views: Sequence[View], device: str) -> float:
    """Unweighted mean over views of the PSNR of whole clamped pictures, dB, as records have it."""
    scores = [psnr(picture(view.camera.to(device)).clamp(0, 1).cpu(), view.rgb()) for view in views]
    return sum(scores) / len(scores)


def _synchronized(device: str) -> float:
    """The time once the device has done its work."""
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)
    return time.perf_counter()
