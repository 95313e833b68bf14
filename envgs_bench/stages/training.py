"""Training: the loop that every method goes through, one full image a step."""

from __future__ import annotations

import csv
import math
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.methods.method import Method

from .events import EventListener
from .health import Health

READ_EVERY = 10  # steps whose losses are read at once: reading waits for the device
CURVE_ROWS = 500
REPORT_SECONDS = 0.2


class Training:
    """One training run of `method` on the scene's training views, and what is known of it at any moment.

    Attributes:
        step: steps done.
        seconds: wall-clock time of `Method.initialize` and of all steps, work on the device included.
        peak_primitives: the most primitives of all sets together, after any step.
        health: what was noticed that a healthy run does not show.
    """

    def __init__(self, method: Method, scene: Scene, steps: int, seed: int) -> None:
        self.method, self.scene, self.steps, self.seed = method, scene, steps, seed
        self.step = 0
        self.seconds = 0.0
        self.peak_primitives = 0
        self._told = 0
        self._psnr: deque[float] = deque(maxlen=len(scene.train))
        self.health = Health(method, steps)

    def run(self, curve: Path, report: EventListener) -> None:
        """Train; `curve` becomes a CSV table of step, seconds, loss, psnr, skipped_steps and primitives_<set>.

        `psnr` is the mean over the last steps, as many as there are training views, of what the method saw in dB.

        Raises:
            Diverged: nothing more can be learned, see `Health`.
            MemoryError: hardly any memory is left.
        """
        started = time.perf_counter()
        try:
            self.method.initialize(self.scene, self.steps)
            if self.method.dropped_losses:
                report({"stage": "training", "steps": self.steps, "dropped_losses": dict(self.method.dropped_losses)})
            with curve.open("w", buffering=1, newline="", encoding="utf-8") as stream:
                self._loop(csv.writer(stream), report, started)
            self._synchronize()
        finally:
            self.seconds = time.perf_counter() - started

    def _loop(self, rows: Any, report: EventListener, started: float) -> None:
        sets = list(self.method.primitives())
        rows.writerow(["step", "seconds", "loss", "psnr", "skipped_steps", *(f"primitives_{name}" for name in sets)])
        every = max(1, self.steps // CURVE_ROWS)
        reported = 0.0
        unread: list[Mapping[str, float | Tensor]] = []
        for view in shuffled(self.scene.train, self.steps, self.seed):
            unread.append(self.method.training_step(view, self.step + 1))
            self.step += 1
            counts = self.method.primitives()
            self.peak_primitives = max(self.peak_primitives, sum(counts.values()))
            self.health.count(self.step, counts)
            last = self.step == self.steps
            wanted = self.step % every == 0 or last
            looks = self.health.due(self.step)
            if not wanted and not looks and len(unread) < READ_EVERY:
                continue
            loss, psnr = self._judge(unread)
            unread.clear()
            if looks:
                self.health.look(self.step, view)
            self._tell_warnings(report)
            now = time.perf_counter()
            if wanted:
                skipped = int(self.method.skipped_steps)
                rows.writerow([self.step, f"{now - started:.3f}", loss, psnr, skipped, *(counts[n] for n in sets)])
            if now - reported > REPORT_SECONDS or last:
                reported = now
                state = {"step": self.step, "steps": self.steps, "loss": loss, "psnr": psnr, "primitives": counts}
                report({"stage": "training", **state})

    def _judge(self, unread: Sequence[Mapping[str, float | Tensor]]) -> tuple[float, float]:
        """The last step's loss and the running PSNR."""
        loss = math.nan
        for step, losses in enumerate(unread, self.step - len(unread) + 1):
            loss, psnr = self.health.read(step, losses)
            if math.isfinite(psnr):
                self._psnr.append(psnr)
        self.health.count_skips(self.step, len(unread))
        return loss, sum(self._psnr) / len(self._psnr) if self._psnr else math.nan

    def _tell_warnings(self, report: EventListener) -> None:
        for warning in self.health.warnings[self._told :]:
            report({"stage": "training", "step": self.step, "steps": self.steps, "warning": warning.model_dump()})
        self._told = len(self.health.warnings)

    def _synchronize(self) -> None:
        if self.method.device.type == "cuda":
            torch.cuda.synchronize(self.method.device)


def shuffled(views: list[View], steps: int, seed: int) -> Iterator[View]:
    """`steps` views: each once in a random order, then again in another, from a generator of this seed."""
    generator = torch.Generator().manual_seed(seed)
    order: list[int] = []
    for _ in range(steps):
        if not order:
            order = torch.randperm(len(views), generator=generator).tolist()
        yield views[order.pop()]
