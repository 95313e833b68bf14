"""Running `envgs-bench run` on the fakes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import pytest
from hydra import compose, initialize_config_dir

from envgs_bench.cli.composition import CONF as COMPOSED_FROM
from envgs_bench.cli.composition import register_choices, settings_of
from envgs_bench.cli.main import main
from envgs_bench.loggers.opening import logging_of
from envgs_bench.records import Failure, Record, Status, find_records, read_record
from envgs_bench.run_lock import RunLock
from envgs_bench.runs.display import Display
from envgs_bench.runs.draft import Draft
from envgs_bench.runs.interruption import INTERRUPTION, Interruption
from envgs_bench.runs.job import located, run_job
from envgs_bench.settings import RunSettings, read_settings
from envgs_bench.stages.events import Event
from envgs_bench.stages.execution import execute
from envgs_bench.stages.stop import Stop

from .forked import forked_processes, without_starter

SUPPORT = Path(__file__).parents[1]
CONF = SUPPORT / "fakes" / "conf"

QUICK = ("method=fake", "dataset=tiny", "steps=4", "timing.frames=1", "timing.seconds=0.01", "device=cpu")


def environment() -> dict[str, str]:
    """What a process needs to find the fakes; without VGG-16's weights, so that every machine does the same."""
    path = os.pathsep.join(filter(None, [str(SUPPORT), os.environ.get("PYTHONPATH")]))
    return {"PYTHONPATH": path, "ENVGS_BENCH_VGG16": "off"}


def set_environment(patch: pytest.MonkeyPatch) -> None:
    """Give this process `environment()`, and with it the processes that it starts, until `patch` is undone."""
    for name, value in environment().items():
        patch.setenv(name, value)


def run(runs_dir: Path, *overrides: str, flags: tuple[str, ...] = ()) -> int:
    """The exit status of one call in this process; each run has a process of its own, forked from it."""
    with forked_processes():
        return run_anew(runs_dir, *overrides, flags=flags)


def run_anew(runs_dir: Path, *overrides: str, flags: tuple[str, ...] = ()) -> int:
    """run() with processes that are started anew, as users' are: where others are to find them by their environment."""
    return main(["run", "--config-dir", str(CONF), *flags, *QUICK, f"runs_dir={runs_dir}", *overrides])


def run_here(runs_dir: Path, *overrides: str, flags: tuple[str, ...] = ()) -> int:
    """run() without processes, of which each imports PyTorch: for tests of what a run leaves, not of how it ends."""
    with without_processes():
        return run(runs_dir, *overrides, flags=flags)


def run_job_here(runs_dir: Path, *overrides: str) -> int:
    """run_here() of one job, composed once and not three times, which takes longer than a small run. Nothing is said.

    0 where it ended with status ok, else 1.
    """
    register_choices(overrides)
    lines = [*QUICK, f"runs_dir={runs_dir}", *overrides]
    with initialize_config_dir(str(COMPOSED_FROM), version_base="1.3"):
        settings = settings_of(compose("config", [*lines, f"hydra.searchpath=[file://{CONF}]"]), lines)
    with without_processes():
        return 0 if run_job(*located(settings), Silent(), INTERRUPTION).ok else 1


class Silent:
    """A display that shows nothing."""

    def start(self, title: str) -> None:
        pass

    def update(self, event: Event) -> None:
        pass

    def stop(self) -> None:
        pass


@contextmanager
def without_processes() -> Iterator[None]:
    """Within it, runs are carried out in this process: on the CPU, without log.txt and without limits."""
    with patch("envgs_bench.runs.job.run_process", _carry_out), without_starter():
        yield


def _carry_out(
    folder: Path, _: RunSettings, device: str, lock: RunLock, display: Display, interruption: Interruption
) -> None:
    settings = read_settings(folder)
    assert (device, settings.timeout_minutes, settings.memory_gb) == ("cpu", None, None)
    draft = Draft(folder, settings)
    status: Status = "ok"
    failure = None
    display.start(folder.name)
    try:
        with logging_of(settings, folder) as logger:
            execute(settings, folder, draft.results, display.update, Stop(), logger)
    except Exception as error:
        status, failure = "failed", Failure(type=type(error).__name__, message=str(error), log_tail="")
    finally:
        display.stop()
    draft.write(status, failure)


def records(runs_dir: Path) -> list[Record]:
    return [read_record(path) for path in find_records(runs_dir)]


def only_folder(runs_dir: Path) -> Path:
    (path,) = find_records(runs_dir)
    return path.parent
