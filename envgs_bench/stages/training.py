"""Training: the loop that every method goes through, one full image a step."""

from __future__ import annotations

import csv
import math
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.memory import peak_host_bytes
from envgs_bench.methods.method import Method

from .budget import FrameLimit
from .events import EventListener
from .health import Health
from .snapshots import Snapshots, State, random_state, set_random_state
from .training_log import TrainingLog

READ_EVERY = 10  # steps whose losses are read at once: reading waits for the device
CURVE_ROWS = 500
REPORT_SECONDS = 0.2


class Training:
    """One training run of `method` on the scene's training views, and what is known of it at any moment.

    Attributes:
        step: steps done.
        seconds: wall-clock time of `Method.initialize` and of all steps, work on the device included; of snapshots and
            of the log not.
        peak_primitives: the most primitives of all sets together, after any step.
        peak_host_bytes: the most memory of the processes that did earlier parts of this training.
        went_on_from: the steps of the snapshots that it went on from.
        health: what was noticed that a healthy run does not show.
        losses: the terms that the loss of some step so far had.
    """

    def __init__(
        self,
        method: Method,
        scene: Scene,
        steps: int,
        seed: int,
        log: TrainingLog | None = None,
        frames: FrameLimit | None = None,
    ) -> None:
        self.method, self.scene, self.steps, self.seed = method, scene, steps, seed
        self.step = 0
        self.seconds = 0.0
        self.peak_primitives = 0
        self.peak_host_bytes = 0
        self.went_on_from: list[int] = []
        self.health = Health(method, steps)
        self.losses: set[str] = set()
        self._told = 0  # warnings
        self._psnr: deque[float] = deque(maxlen=len(scene.train))
        self._unread: list[Mapping[str, float | Tensor]] = []  # the last steps' losses
        self._seconds_before = 0.0
        self._snapshots: Snapshots | None = None
        self._log, self._frames = log, frames

    def run(self, curve: Path, report: EventListener, snapshots: Snapshots | None = None) -> None:
        """Train; `curve` becomes a CSV table of step, seconds, loss, psnr, skipped_steps and primitives_<set>.

        `psnr` is the mean over the last steps, as many as there are training views, of what the method saw in dB.
        Where `snapshots` have a state, the training goes on from it and ends where it would have ended without the
        interruption, bitwise on the CPU with the same number of threads.

        Raises:
            Diverged: nothing more can be learned, see `Health`.
            MemoryError: hardly any memory is left.
        """
        self._began = time.perf_counter()
        self._snapshots = snapshots
        state = snapshots.read() if snapshots else None
        try:
            if state is None:
                self.method.initialize(self.scene, self.steps)
            else:
                self._go_on_from(state)
            if self.method.dropped_losses:
                report({"stage": "training", "steps": self.steps, "dropped_losses": dict(self.method.dropped_losses)})
            if self.method.notes:
                report({"stage": "training", "steps": self.steps, "notes": list(self.method.notes)})
            self._tell_warnings(report)  # those before an interruption: who reads this may not have heard of them
            rows = _rows_up_to(curve, self.step) if self.step else []
            with curve.open("w", buffering=1, newline="", encoding="utf-8") as stream:
                stream.writelines(rows)
                self._loop(csv.writer(stream), report)
            self._synchronize()
        finally:
            self.seconds = self._clock()

    def _clock(self) -> float:
        """Seconds of training so far, those before an interruption too."""
        other = sum(part.seconds for part in (self._snapshots, self._log) if part)
        return self._seconds_before + time.perf_counter() - self._began - other

    def _loop(self, rows: Any, report: EventListener) -> None:
        sets = list(self.method.primitives())
        if not self.step:
            rows.writerow(
                ["step", "seconds", "loss", "psnr", "skipped_steps", *(f"primitives_{name}" for name in sets)]
            )
        every = max(1, self.steps // CURVE_ROWS)
        reported = 0.0
        unread = self._unread
        for view in islice(shuffled(self.scene.train, self.steps, self.seed), self.step, None):
            if self._snapshots and self._snapshots.is_due and self.step:
                self._snapshots.save(self._state)
                self._snapshots.stop.heed()
            unread.append(self.method.training_step(view, self.step + 1))
            self.step += 1
            counts = self.method.primitives()
            self.peak_primitives = max(self.peak_primitives, sum(counts.values()))
            self.health.count(self.step, counts)
            if self._frames and self._frames.due(self.step):
                self._frames.look()
                counts = self.method.primitives()
                self.health.expect(counts)
            last = self.step == self.steps
            if self._log and self._log.due(self.step, last):
                self._synchronize()  # lest drawing be charged with the steps before it
                self._log.look(self.step)
            wanted = self.step % every == 0 or last
            looks = self.health.due(self.step)
            if not wanted and not looks and len(unread) < READ_EVERY:
                continue
            self.losses.update(name for losses in unread for name in losses if name not in ("loss", "psnr"))
            loss, psnr = self._judge(unread)
            losses = unread[-1]
            unread.clear()
            if looks:
                self.health.look(self.step, view)
            self._tell_warnings(report)
            now = self._clock()
            if wanted:
                skipped = int(self.method.skipped_steps)
                rows.writerow([self.step, f"{now:.3f}", loss, psnr, skipped, *(counts[n] for n in sets)])
                if self._log:
                    known = {"psnr": psnr, "skipped_steps": skipped, "seconds": now}
                    self._log.curve(self.step, losses, known | {f"primitives_{n}": counts[n] for n in sets})
            if now - reported > REPORT_SECONDS or last:
                reported = now
                state = {"step": self.step, "steps": self.steps, "loss": loss, "psnr": psnr, "primitives": counts}
                report({"stage": "training", **state})

    def _state(self) -> State | None:
        """What a snapshot holds, None of a method that cannot go on from one."""
        method = self.method.training_state()
        if method is None:
            return None
        return {
            "method": method,
            "random": random_state(),
            "step": self.step,
            "seconds": self._clock(),
            "peak_primitives": self.peak_primitives,
            "peak_host_bytes": max(self.peak_host_bytes, peak_host_bytes()),
            "psnr": list(self._psnr),
            # Not judged before they would have been: what is judged together must not depend on when this is saved.
            "unread": [{name: float(value) for name, value in losses.items()} for losses in self._unread],
            "health": self.health.state(),
            "frames": self._frames.state() if self._frames else None,
            "losses": sorted(self.losses),
            "went_on_from": self.went_on_from,
        }

    def _go_on_from(self, state: State) -> None:
        """Become what `_state` returned."""
        self.method.resume(self.scene, self.steps, state["method"])
        if self._frames:
            self._frames.restore(state["frames"])
        self.step, self._seconds_before = state["step"], state["seconds"]
        self.peak_primitives, self.peak_host_bytes = state["peak_primitives"], state["peak_host_bytes"]
        self._psnr.extend(state["psnr"])
        self._unread.extend(state["unread"])
        self.health.restore(state["health"])
        self.losses.update(state["losses"])
        self.went_on_from = [*state["went_on_from"], self.step]
        set_random_state(state["random"])
        print(f"going on from step {self.step}", flush=True)

    def _judge(self, unread: Sequence[Mapping[str, float | Tensor]]) -> tuple[float, float]:
        """The last step's loss and the running PSNR."""
        self.method.settle()
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


def _rows_up_to(curve: Path, step: int) -> list[str]:
    """The head of the curve of an interrupted training and its rows up to `step`, later ones being done again."""
    try:
        lines = curve.read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError):
        return []
    numbers = ((line, line.partition(",")[0]) for line in lines if line.endswith("\n"))
    return [line for line, number in numbers if number == "step" or (number.isdecimal() and int(number) <= step)]


def shuffled(views: list[View], steps: int, seed: int) -> Iterator[View]:
    """`steps` views: each once in a random order, then again in another, from a generator of this seed."""
    generator = torch.Generator().manual_seed(seed)
    order: list[int] = []
    for _ in range(steps):
        if not order:
            order = torch.randperm(len(views), generator=generator).tolist()
        yield views[order.pop()]
