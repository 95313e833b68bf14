"""Running `envgs-bench run` on the fakes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from envgs_bench.cli.main import main
from envgs_bench.records import Record, find_records, read_record

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
    """The exit status of one call in this process; each run has a process of its own."""
    return main(["run", "--config-dir", str(CONF), *flags, *QUICK, f"runs_dir={runs_dir}", *overrides])


def records(runs_dir: Path) -> list[Record]:
    return [read_record(path) for path in find_records(runs_dir)]


def only_folder(runs_dir: Path) -> Path:
    (path,) = find_records(runs_dir)
    return path.parent
