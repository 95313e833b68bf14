"""MLflow: a run of its own in a database beside the runs, one for all, or where $MLFLOW_TRACKING_URI says."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envgs_bench.settings import RunSettings

RUN_NAME = "mlflow_run.txt"  # which of MLflow's runs this one is, in its folder, for when it goes on
LONGEST_VALUE = 500  # characters of a parameter that every version takes


def open_logger(settings: RunSettings, folder: Path) -> MlflowLogger:
    """A logger of an MLflow run that a training which goes on goes on with."""
    return MlflowLogger(settings, folder)


class MlflowLogger:
    def __init__(self, settings: RunSettings, folder: Path) -> None:
        from mlflow import MlflowClient
        from mlflow.entities import Metric

        self._metric = Metric
        runs = settings.runs_dir
        self._client = MlflowClient(os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{runs / 'mlflow.db'}")
        known = folder / RUN_NAME
        self._run = known.read_text() if known.is_file() else self._new_run(settings)
        known.write_text(self._run)
        self._client.update_run(self._run, "RUNNING")

    def _new_run(self, settings: RunSettings) -> str:
        name, runs = settings.dataset_name, settings.runs_dir
        experiment = self._client.get_experiment_by_name(name)
        if experiment is None:
            own = "MLFLOW_TRACKING_URI" not in os.environ
            place = (runs / "mlflow_pictures" / name).as_uri() if own else None
            number = self._client.create_experiment(name, artifact_location=place)
        else:
            number = experiment.experiment_id
        title = f"{settings.method_name} seed {settings.seed}"
        run = self._client.create_run(number, run_name=title).info.run_id
        for key in ("method", "steps", "seed", "protocol", "perturb", "budget", "overrides"):
            self._client.log_param(run, key, str(getattr(settings, key))[:LONGEST_VALUE])
        return run

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        now = int(1000 * time.time())
        self._client.log_batch(self._run, [self._metric(name, value, now, step) for name, value in values.items()])

    def picture(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        self._client.log_image(self._run, picture, key=name, step=step, synchronous=True)

    def close(self) -> None:
        self._client.set_terminated(self._run)
