"""Methods that are quick, and that fail in every way a method can. Chosen by import path, each in its own process."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from envgs_bench.core import Camera, Rendering, Scene, Statistics, View
from envgs_bench.methods.method import Method


@dataclass(frozen=True)
class Settings:
    rate: float = 0.5  # share of the way to each view's mean color
    crash_at: int = 0  # step at which a failing method fails
    tells_psnr: bool = True  # by which it learns nothing, so that a run of 2,000 steps or more is ended


class MeanColor(Method):
    """Draws every view in one color, the running mean of the training views, with one upright surface behind."""

    Settings: ClassVar[type] = Settings

    def initialize(self, scene: Scene, steps: int) -> None:
        self.color = torch.full((3,), 0.5)
        print(f"learning the mean color of {scene.name}")

    def training_step(self, view: View, step: int) -> dict[str, float]:
        difference = view.rgb().mean((0, 1)) - self.color
        if difference.isfinite().all():
            self.color = self.color + self.settings.rate * difference
        else:
            self.skipped_steps += 1
        error = difference.square().mean()
        losses = {"loss": float(error)}
        return losses | {"psnr": float(-10 * error.log10())} if self.settings.tells_psnr else losses

    def render(self, camera: Camera) -> Rendering:
        height, width = camera.height, camera.width
        flat = torch.ones(height, width)
        facing = -camera.world_to_camera[2, :3].expand(height, width, 3)
        return Rendering(
            color=self.color.expand(height, width, 3),
            alpha=flat,
            depth=flat,
            normal=facing,
            extras=torch.zeros(height, width, 0),
            hits=flat.int(),
            statistics=Statistics(weights=torch.ones(1)),
            layers={"beta": flat[..., None] / 2},
        )

    def primitives(self) -> dict[str, int]:
        return {"base": 1, "env": 0}

    def model_bytes(self) -> dict[str, int]:
        return {"base": 12, "env": 0}

    def training_state(self) -> dict[str, Any]:
        return {"color": self.color, "skipped_steps": self.skipped_steps}

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self.initialize(scene, steps)
        self.color, self.skipped_steps = state["color"], state["skipped_steps"]

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        torch.save(self.color, folder / "color.pt")

    def load(self, folder: Path) -> None:
        self.color = torch.load(folder / "color.pt")


class _Failing(MeanColor):
    """Trains without a loss, and fails."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.dropped_losses["gloss"] = f"{scene.name} has no varnish"

    def training_step(self, view: View, step: int) -> dict[str, float]:
        losses = super().training_step(view, step)
        return self.fail(losses) if step >= self.settings.crash_at else losses

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        raise NotImplementedError


class Raises(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        raise RuntimeError("the surfels are in a bad mood")


class Segfaults(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        os.kill(os.getpid(), signal.SIGSEGV)
        return losses


class IsKilled(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        os.kill(os.getpid(), signal.SIGKILL)
        return losses


class Exits(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        os._exit(3)


class RunsOutOfMemory(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        torch.empty(2**60, dtype=torch.uint8)
        return losses


class TakesMemory(_Failing):
    """2 GB and no more, in parts that a limit of the machine's would not refuse."""

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        self.taken = [torch.ones(2**24) for _ in range(32)]
        return losses


class IsSlow(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        time.sleep(0.1)
        return losses


class Hangs(_Failing):
    """In native code that sees no signals."""

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        for number in (signal.SIGALRM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)
        while True:
            time.sleep(1)


class LosesItsLoss(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        self.skipped_steps += 1
        return {**losses, "loss": float("nan")}


class DiesAfterAWarning(LosesItsLoss):
    """When its losses have been read, and before there were too many."""

    def training_step(self, view: View, step: int) -> dict[str, float]:
        if step == self.settings.crash_at + 10:
            os._exit(3)
        return super().training_step(view, step)


class FailsWhenAsked(_Failing):
    """Asked to end, by Ctrl-C, it fails before it does so."""

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        os.kill(os.getpid(), signal.SIGINT)
        raise RecursionError("half of a module was imported")


class RendersNaN(MeanColor):
    def render(self, camera: Camera) -> Rendering:
        rendering = super().render(camera)
        rendering.color = torch.full_like(rendering.color, float("nan"))
        return rendering


class Announces(MeanColor):
    """Writes the file `started` into the working folder and is slow, unless the file is there: to be interrupted."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.is_slow = not Path("started").exists()

    def training_step(self, view: View, step: int) -> dict[str, float]:
        if self.is_slow:
            Path("started").touch()
            time.sleep(0.1)
        return super().training_step(view, step)


class Waits(MeanColor):
    """A fifth of a second a step, or as the environment says."""

    def training_step(self, view: View, step: int) -> dict[str, float]:
        time.sleep(float(os.environ.get("FAKE_STEP_SECONDS", "0.2")))
        return super().training_step(view, step)


class Complains(MeanColor):
    """Says at such length what it trains without that no pipe holds it."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.dropped_losses["gloss"] = "there is no varnish; " * 20_000


class LeavesAThread(MeanColor):
    """Its thread never ends."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        threading.Thread(target=threading.Event().wait).start()


class LeavesProcesses(MeanColor):
    """One in its group, one in a session of its own, and one that has all its files: their numbers are in `left`."""

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        sleep = [sys.executable, "-c", "import time; time.sleep(600)"]
        left = [subprocess.Popen(sleep).pid, subprocess.Popen(sleep, start_new_session=True).pid]
        left.append(os.fork())
        if left[-1] == 0:
            os.setsid()
            time.sleep(600)
        Path("left").write_text(" ".join(map(str, left)), encoding="utf-8")


class Chatters(_Failing):
    """Prints 50 MB, and fails with as long a message."""

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        print("the first line")
        for _ in range(50):
            print("a" * 10**6)
        print("the last line")
        raise RuntimeError("begins " + "b" * 5 * 10**7 + " ends")


class FillsItsDisk(_Failing):
    """Writes beside its run until nothing more can be written."""

    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        with (Path(os.environ["ENVGS_BENCH_RUN"]).parents[3] / "filler").open("wb", buffering=0) as stream:
            while True:
                stream.write(bytes(2**16))


class DeletesItsFolder(_Failing):
    def fail(self, losses: dict[str, float]) -> dict[str, float]:
        shutil.rmtree(os.environ["ENVGS_BENCH_RUN"])
        return losses


class Forgets(MeanColor):
    def load(self, folder: Path) -> None:
        super().load(folder)
        self.color = torch.zeros(3)


class IsRandom(MeanColor):
    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.color = torch.rand(3, generator=torch.Generator().manual_seed(time.time_ns() % 2**31))


class NamesNoTotal(MeanColor):
    def training_step(self, view: View, step: int) -> dict[str, float]:
        return {"rgb": super().training_step(view, step)["loss"]}
