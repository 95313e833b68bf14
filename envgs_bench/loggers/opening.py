"""Opening: the logger that a run was given, which can fail without the run."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from envgs_bench.run_folder import LOGGED
from envgs_bench.settings import RunSettings, SettingsError

if TYPE_CHECKING:  # whether a library is there is asked without torch
    from envgs_bench.stages.training_log import Logger

LIBRARIES = {"tensorboard": ("tensorboard",), "wandb": ("wandb",), "mlflow": ("mlflow", "sqlalchemy", "alembic")}


def require_logger(settings: RunSettings) -> None:
    """Raises SettingsError that says what to install where the logger's library is not."""
    kind = settings.logger.kind if settings.logger else None
    missing = [name for name in LIBRARIES.get(kind or "", ()) if importlib.util.find_spec(name) is None]
    if missing:
        raise SettingsError(f"logger={kind} needs {', '.join(missing)}: pip install 'envgs-bench[{kind}]'")


@contextmanager
def logging_of(settings: RunSettings, folder: Path) -> Iterator[Logger | None]:
    """The logger of the run in `folder`, closed after the block; None where it has none, or none can be had."""
    if settings.logger is None:
        yield None
        return
    logger = Guarded(lambda: _opened(settings, folder / LOGGED))
    try:
        yield logger
    finally:
        logger.close()


def _opened(settings: RunSettings, folder: Path) -> Logger:
    assert settings.logger is not None
    require_logger(settings)
    folder.mkdir(parents=True, exist_ok=True)
    return importlib.import_module(f".{settings.logger.kind}_logger", __package__).open_logger(settings, folder)


class Guarded:
    """Another logger, until it fails: that is said once, and the run goes on without."""

    def __init__(self, opened: Callable[[], Logger]) -> None:
        self._logger: Logger | None = None
        self._try(lambda: setattr(self, "_logger", opened()))

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        if logger := self._logger:
            self._try(lambda: logger.numbers(step, values))

    def picture(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        if logger := self._logger:
            self._try(lambda: logger.picture(step, name, picture))

    def close(self) -> None:
        if logger := self._logger:
            self._try(logger.close)

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except Exception as error:  # of a library, a disk or a network: none of them is a reason not to train
            self._logger = None
            print(f"training goes on without its logger: {error!r}", file=sys.stderr, flush=True)
