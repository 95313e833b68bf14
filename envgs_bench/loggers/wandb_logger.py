"""Weights & Biases: a run of its own in the run's folder, uploaded by `wandb sync` or where $WANDB_MODE says so."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envgs_bench.settings import RunSettings

PROJECT = "envgs-bench"  # unless $WANDB_PROJECT names another


def open_logger(settings: RunSettings, folder: Path) -> WandbLogger:
    """A logger of a wandb run that a training which goes on goes on with."""
    return WandbLogger(settings, folder)


class WandbLogger:
    def __init__(self, settings: RunSettings, folder: Path) -> None:
        import wandb

        self._image = wandb.Image
        mode: Any = os.environ.get("WANDB_MODE", "offline")  # wandb says what it may be
        self._run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            mode=mode,
            id=hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16],
            resume="allow",
            dir=str(folder),
            name=f"{settings.dataset_name} {settings.method_name} seed {settings.seed}",
            group=settings.dataset_name,
            config=settings.model_dump(mode="json"),
            settings=wandb.Settings(console="off", silent=True),
        )

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        self._run.log(dict(values), step=step)

    def picture(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        self._run.log({name: self._image(picture)}, step=step)

    def close(self) -> None:
        self._run.finish()
