"""TrainingLog: what a run tells a logger while it trains. Which library that is, nothing here knows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.methods.method import Method
from envgs_bench.methods.training.losses import training_psnr

from .pictures import as_bytes, error_picture
from .snapshots import random_state, set_random_state


class Logger(Protocol):
    """Takes numbers and pictures, step by step, to show them while a run trains. Its methods raise nothing."""

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        """Values by name, of which a slash makes groups: `training/psnr`."""

    def picture(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        """A picture [H, W, 3], sRGB, that takes the place of its name's at an earlier step."""

    def close(self) -> None:
        """The training is over, however it ended: write what is not written yet."""


class TrainingLog:
    """Curves as often as the run's own has a row; every `every` steps a few fixed views as the method draws them.

    Pictures are the photograph, what is drawn, and its error side by side; the mean PSNR that is told is that of
    these views alone. Views are the scene's for validation where it has some, else its test views:
    nothing is learned from either.

    Attributes:
        seconds: what logging took so far, which is no part of the training's time.
    """

    def __init__(self, logger: Logger, method: Method, scene: Scene, every: int, views: int) -> None:
        self.seconds = 0.0
        self._logger, self._method, self._every = logger, method, every
        self._group = "validation" if scene.val else "test"
        self._views = spread(scene.val or scene.test, views)

    def curve(self, step: int, losses: Mapping[str, float | Tensor], values: Mapping[str, float]) -> None:
        """The terms of a step's loss, and what else is known of it."""
        began = time.perf_counter()
        terms = {f"training/{name}": float(value) for name, value in losses.items() if name != "psnr"}
        self._logger.numbers(step, terms | {f"training/{name}": value for name, value in values.items()})
        self.seconds += time.perf_counter() - began

    def due(self, step: int, last: bool) -> bool:
        """Whether views are to be drawn after this step."""
        return step % self._every == 0 or last

    def look(self, step: int) -> None:
        """Draw the views, which changes nothing that is trained."""
        began = time.perf_counter()
        state = random_state()
        self._method.prepare()
        psnr = []
        for view in self._views:
            target, image = view.rgb(), self._method.picture(view.camera.to(self._method.device)).cpu()
            psnr.append(float(training_psnr(image, target)))
            error = error_picture(image, target)[..., None].expand_as(image)
            self._logger.picture(step, f"{self._group}/{view.name}", as_bytes(torch.cat([target, image, error], dim=1)))
        self._logger.numbers(step, {f"{self._group}/psnr": sum(psnr) / len(psnr)})
        set_random_state(state)
        self.seconds += time.perf_counter() - began


def spread(views: Sequence[View], count: int) -> list[View]:
    """`count` of the views, or all where there are fewer, evenly spaced from the first."""
    count = min(count, len(views))
    return [views[index * len(views) // count] for index in range(count)]
