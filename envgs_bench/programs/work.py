"""Work: a program's training and drawing in a run's folder, and how far they have come, whoever interrupts them."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import time
import uuid
from collections.abc import Callable
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from envgs_bench.records import write_atomically
from envgs_bench.regular_file import read_regular_text

from .command import environment_on, run_command
from .isolation import isolated
from .memory import MemoryWatch
from .recipe import ProgramChoice, Reading, files_of, words_of

STATE_NAME = "state.json"
MOST_BYTES = 100_000_000  # of a text file that a number is read from
PUBLISHED_STEPS = 30_000  # of 3DGS's runs, for which its descendants' schedules are written
TEST_EVERY = 8  # as data sets are split, and as other programs split them


class WorkState(BaseModel):
    """What is done, and what it took so far; stored, so that an interrupted run goes on from it."""

    model_config = ConfigDict(extra="forbid")

    started: bool = False  # the training, whether or not it has ended
    trained: bool = False
    drawn: bool = False
    train_seconds: float = 0.0
    draw_seconds: float | None = None  # None where training draws
    own_seconds: float | None = None
    peak_host_bytes: int | None = None
    peak_device_bytes: int | None = None
    commands: dict[str, list[str]] = {}


class Work:
    """The program of `choice`, at work in `folder`.

    Attributes:
        data: the folder that it reads.
        output: the folder that it writes into.
        values: of the recipe's placeholders.
        state: how far it has come.
    """

    def __init__(self, choice: ProgramChoice, folder: Path, steps: int, seed: int, device: str) -> None:
        self.choice, self.folder, self.device = choice, folder, device
        self.data, self.output = folder / "data", folder / "output"
        self.values = {
            **{"data": str(self.data), "output": str(self.output), "home": choice.home or "", "python": choice.python},
            **{"steps": str(steps), "last_step": str(steps - 1), "share": _share(steps)},
            **{"seed": str(seed), "device": device},
            **{"test_every": str(TEST_EVERY), "on_white": "", "arguments": choice.arguments},
        }
        folder.mkdir(parents=True, exist_ok=True)
        self.state = self._read()

    def train(self, watch: MemoryWatch, told: Callable[[int], None]) -> None:
        """Train, unless that is done; `told` hears of steps. Raises as `run_command`."""
        if self.state.trained:
            return
        recipe = self.choice.recipe
        goes_on = self.state.started and bool(recipe.resume)
        if not goes_on:
            shutil.rmtree(self.output, ignore_errors=True)
            self.state = WorkState()
        self.output.mkdir(exist_ok=True)
        self.state.started = True
        self._write()
        lines = _Lines(recipe.step, recipe.seconds)
        began = time.monotonic() - self.state.train_seconds
        try:
            for command in recipe.resume if goes_on else recipe.train:
                self._run("train", command, watch, lines, told)
        finally:
            self.state.train_seconds = time.monotonic() - began
            self._measured(watch)
        self.state.own_seconds = self._own_seconds(lines)
        self.state.trained = True
        self._write()

    def draw(self, watch: MemoryWatch) -> None:
        """Draw the test views, unless that is done, or training does. Raises as `run_command`."""
        if self.state.drawn or not self.choice.recipe.draw:
            return
        began = time.monotonic()
        for command in self.choice.recipe.draw:
            self._run("draw", command, watch, _Lines(None, None), lambda step: None)
        self.state.draw_seconds, self.state.drawn = time.monotonic() - began, True
        self._write()

    def _run(self, stage: str, command: str, watch: MemoryWatch, lines: _Lines, told: Callable[[int], None]) -> None:
        choice = self.choice
        words = words_of(command, self.values)
        environment = environment_on(self.device, choice.recipe.environment)
        seen = [self.folder, *([Path(choice.home)] if choice.home else [])]
        name = f"envgs-bench-{uuid.uuid4().hex[:12]}"
        started = isolated(words, choice.isolation or choice.recipe.isolation, environment, seen, name)
        self.state.commands.setdefault(stage, []).append(" ".join(started.words))

        def tell() -> None:
            if lines.step is not None:
                told(lines.step)

        run_command(started, Path(choice.home or self.folder), watch, lines.take, tell)

    def _measured(self, watch: MemoryWatch) -> None:
        for name in ("peak_host_bytes", "peak_device_bytes"):
            known = [value for value in (getattr(self.state, name), getattr(watch, name)) if value is not None]
            setattr(self.state, name, max(known, default=None))
        self._write()

    def _own_seconds(self, lines: _Lines) -> float | None:
        reading = self.choice.recipe.seconds
        if reading is None:
            return None
        found = [lines.seconds]
        if reading.file:
            texts = (_text(path) for path in files_of(reading.file, self.values))
            found = [match for text in texts for match in re.findall(reading.pattern, text)]
        try:
            return float(found[-1].replace(",", "")) * reading.unit if found and found[-1] else None
        except ValueError:
            return None

    def _read(self) -> WorkState:
        try:
            return WorkState.model_validate_json(read_regular_text(self.folder / STATE_NAME, MOST_BYTES))
        except (OSError, UnicodeDecodeError, ValidationError):
            return WorkState()

    def _write(self) -> None:
        write_atomically(self.folder / STATE_NAME, self.state.model_dump_json(indent=1))


class _Lines:
    """What a program's output tells: its step, and how long it took."""

    def __init__(self, step: str | None, seconds: Reading | None) -> None:
        self._step = re.compile(step) if step else None
        self._seconds = re.compile(seconds.pattern) if seconds and not seconds.file else None
        self.step: int | None = None
        self.seconds: str | None = None

    def take(self, line: str) -> None:
        if self._step and (found := self._step.findall(line)):
            self.step = int(found[-1].replace(",", ""))
        if self._seconds and (found := self._seconds.findall(line)):
            self.seconds = found[-1]


def _share(steps: int) -> str:
    """steps / PUBLISHED_STEPS, such that a program that multiplies and cuts the rest off gets the steps again."""
    share = steps / PUBLISHED_STEPS
    while int(PUBLISHED_STEPS * share) < steps:
        share = math.nextafter(share, math.inf)
    return repr(share)


def commit_of(home: str | None) -> str | None:
    """The commit that the program's folder has checked out; None where it is no checkout of its own."""
    if not home or not os.path.exists(Path(home) / ".git"):
        return None
    try:
        answer = subprocess.run(
            ["git", "-C", home, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip() or None


def _text(path: Path) -> str:
    try:
        return read_regular_text(path, MOST_BYTES)
    except (OSError, UnicodeDecodeError):
        return ""
