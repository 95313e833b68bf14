"""Display: how far a run has come, as a progress bar on a terminal and as a few lines anywhere else."""

from __future__ import annotations

import sys
import time
from typing import Protocol, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from envgs_bench.parts import LOSSES
from envgs_bench.plain_text import plain
from envgs_bench.stages.events import Event

from .estimates import duration, training_left

LINES_A_STAGE = 10


class Display(Protocol):
    """Shows one run at a time; `update` takes the events that the run's process reports."""

    def start(self, title: str) -> None: ...

    def update(self, event: Event) -> None: ...

    def stop(self) -> None: ...


def make_display(alone: bool, position: str = "") -> Display:
    """A bar where standard error is a terminal that no other run writes to at the same time, else lines.

    `position` is put before what either shows: which job of how many it is.
    """
    return Bar(position=position) if alone and sys.stderr.isatty() else Lines(sys.stderr, position)


class Bar:
    """One rich progress bar, gone when the run is; what the run does without stays above it."""

    def __init__(self, console: Console | None = None, position: str = "") -> None:
        self._console = console or Console(stderr=True)
        self._position = position
        self._progress: Progress | None = None

    def start(self, title: str) -> None:
        title = plain(f"{self._position}{title}")
        columns = (
            TextColumn("{task.fields[title]}", markup=False),
            TextColumn("{task.description}", style="bold", markup=False),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[numbers]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}", markup=False),
        )
        self._progress = Progress(*columns, console=self._console, transient=True)
        self._progress.start()
        self._title, self._stage = title, "starting"
        self._task = self._progress.add_task(self._stage, total=None, title=title, numbers="", left="")

    def update(self, event: Event) -> None:
        if self._progress is None:
            return
        for text in notices(event):
            self._console.print(plain(f"{self._title}: {text}"), markup=False, highlight=False, soft_wrap=True)
        if event["stage"] != self._stage:
            self._stage = event["stage"]
            self._pace = Pace(event)
            self._progress.remove_task(self._task)
            self._task = self._progress.add_task(
                plain(self._stage), total=event.get("steps"), title=self._title, numbers="", left=""
            )
        left = self._pace.left(event)
        self._progress.update(self._task, completed=event.get("step", 0), numbers=numbers(event), left=left)

    def stop(self) -> None:
        if self._progress is not None:
            self._progress.stop()
            self._progress = None


class Lines:
    """A line for each stage, LINES_A_STAGE while it trains, and one for each loss that is dropped and each warning."""

    def __init__(self, stream: TextIO, position: str = "") -> None:
        self._stream, self._position = stream, position

    def start(self, title: str) -> None:
        self._title, self._stage, self._share = f"{self._position}{title}", "", -1
        self._print("starting")

    def update(self, event: Event) -> None:
        stage, step, steps = event["stage"], event.get("step", 0), event.get("steps", 0)
        if stage != self._stage:
            self._stage, self._share, self._pace = stage, -1, Pace(event)
            if stage != "training":
                self._print(stage)
        for text in notices(event):
            self._print(text)
        share = LINES_A_STAGE * step // steps if steps else 0
        if "loss" in event and share != self._share:
            self._share = share
            self._print(f"step {step}/{steps}  {numbers(event)}  {self._pace.left(event)}".rstrip())

    def stop(self) -> None:
        pass

    def _print(self, text: str) -> None:
        print(plain(f"{self._title}: {text}"), file=self._stream, flush=True)


class Pace:
    """How long a training may still take, from the first event of its stage on."""

    def __init__(self, event: Event) -> None:
        self._began, self._first = time.monotonic(), event.get("step", 0)

    def left(self, event: Event) -> str:
        """As people say it; "" outside of a training, and at its ends."""
        step, steps = event.get("step", 0), event.get("steps", 0)
        if "loss" not in event or not self._first < step < steps:
            return ""
        return f"about {duration(training_left(time.monotonic() - self._began, self._first, step, steps))} left"


def notices(event: Event) -> list[str]:
    """What was noticed of the data; what the run trains without, and why, a line a loss; and what it warns of."""
    dropped = event.get("dropped_losses", {}).items()
    lines = [f"trains without {LOSSES.get(loss, loss)}: {why}" for loss, why in dropped]
    warning = event.get("warning")
    lines += event.get("notes", [])
    return [*lines, f"warning at step {warning['step']}: {warning['message']}"] if warning else lines


def numbers(event: Event) -> str:
    """Loss, PSNR and primitives of a training event, of the sets that are there; "" of any other."""
    if "loss" not in event:
        return ""
    counts = "  ".join(f"{name} {count:,}" for name, count in event["primitives"].items() if count)
    return f"loss {event['loss']:.4f}  PSNR {event['psnr']:.2f}  {counts}"
