"""The process of one run, `python -m envgs_bench.worker <run folder>`: trains, renders, scores, times, leaves a record.

Reads config.yaml from the folder. Progress goes to standard output as one JSON object a line; everything else that is
printed, by Python or by native code, goes to standard error, which the parent makes log.txt.
"""

from __future__ import annotations

import faulthandler
import json
import os
import random
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import TextIO

import numpy as np
import torch

from envgs_bench.core import Scene
from envgs_bench.datasets.registry import load_scene
from envgs_bench.datasets.store.progress import listening
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics import Protocol, WeightsUnavailable, get_protocol, make_perceptual_loss
from envgs_bench.records import RENDERS, Cost, Failure, Status
from envgs_bench.settings import read_settings
from envgs_bench.stages.evaluation import evaluate
from envgs_bench.stages.renders import score_renders
from envgs_bench.stages.timing import time_frames
from envgs_bench.stages.training import Diverged, Report, Training

from .draft import Draft, log_tail
from .provenance import peak_device_bytes, peak_host_bytes


class TimeUp(BaseException):
    """timeout_minutes are over. Not an Exception, so that nothing between here and the worker takes it for its own."""


def main(arguments: list[str]) -> int:
    """Run the run of the folder named in `arguments`; 0 where it ended with status ok."""
    report = _reporter(_take_standard_output())
    faulthandler.enable()
    folder = Path(arguments[0])
    settings = read_settings(folder)
    draft = Draft(folder, settings)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    _start_clock(settings.timeout_minutes)
    status: Status = "ok"
    failure = None
    try:
        execute(draft, report)
    except BaseException as error:
        signal.setitimer(signal.ITIMER_REAL, 0)
        traceback.print_exc()
        sys.stderr.flush()
        status = _status(error)
        failure = Failure(type=type(error).__name__, message=_message(error), log_tail=log_tail(folder))
    draft.write(status, failure)
    return 0 if status == "ok" else 1


def execute(draft: Draft, report: Report) -> None:
    """All of a run, in order, each part's result put into `draft` as soon as it is there."""
    settings, folder = draft.settings, draft.folder
    _seed(settings.seed)
    protocol = get_protocol(settings.protocol)
    if settings.method.kind == RENDERS:
        _score_renders(draft, protocol, report)
        return
    method = create_method(settings.method.kind, settings.method.settings, settings.device, settings.seed)
    _offer_perceptual_loss(method)
    scene = _load(draft, report)
    _check_scene(scene)
    training = Training(method, scene, settings.steps, settings.seed)
    try:
        training.run(folder / "curve.csv", report)
    finally:
        if training.step:  # however it ends, what was learned is kept
            draft.cost = _cost(method, training)
            method.save(folder / "checkpoint")
    report({"stage": "preparing"})
    method.prepare()
    draft.metrics, draft.masked = evaluate(method, scene.test, protocol, folder, report)
    report({"stage": "timing"})
    draft.timing = time_frames(method, scene.test, settings.timing)
    draft.cost = _cost(method, training)


def _load(draft: Draft, report: Report) -> Scene:
    """The run's scene; making one for the first time may take minutes, and its source says how far it has come."""
    report({"stage": "loading"})
    with listening(lambda stage, done, total: report({"stage": stage, "step": done, "steps": total})):
        scene = load_scene(draft.settings.dataset, draft.settings.cache_dir)
    draft.dataset = scene.name
    return scene


def _score_renders(draft: Draft, protocol: Protocol, report: Report) -> None:
    """The run of a method whose pictures come from elsewhere: nothing is trained, drawn or timed."""
    settings = draft.settings
    draft.steps = 0
    scene = _load(draft, report)
    draft.metrics, draft.masked = score_renders(settings.method.settings, scene, protocol, draft.folder, report)


def _offer_perceptual_loss(method: Method) -> None:
    """Methods must not import metrics: those that use the perceptual loss are given it, if it can be had."""
    if method.uses_perceptual:
        try:
            method.perceptual = make_perceptual_loss(method.device)
        except WeightsUnavailable as error:
            print(f"training without the perceptual loss: {error}", file=sys.stderr)


def _check_scene(scene: Scene) -> None:
    for name, views in (("training", scene.train), ("test", scene.test)):
        if not views:
            raise ValueError(f"data set {scene.name} has no {name} views: it needs at least two images")


def _cost(method: Method, training: Training) -> Cost:
    sizes = method.model_bytes()
    return Cost(
        primitives=method.primitives(),
        bytes=sizes,
        model_bytes=sum(sizes.values()),
        train_seconds=training.seconds,
        peak_host_bytes=peak_host_bytes(),
        peak_device_bytes=peak_device_bytes(method.device),
        skipped_steps=int(method.skipped_steps),
        peak_primitives=training.peak_primitives,
    )


def _seed(seed: int) -> None:
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (for libraries that draw from the global generator)
    torch.manual_seed(seed)


def _start_clock(minutes: float | None) -> None:
    def ring(number: int, frame: FrameType | None) -> None:
        raise TimeUp(f"not finished after timeout_minutes={minutes:g}")

    if minutes is not None:
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, 60 * minutes)


def _status(error: BaseException) -> Status:
    if isinstance(error, TimeUp):
        return "timeout"
    if isinstance(error, KeyboardInterrupt | BrokenPipeError):
        return "interrupted"
    if isinstance(error, Diverged):
        return "diverged"
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or "can't allocate memory" in str(error):
        return "out_of_memory"  # PyTorch's CPU allocator says it in a RuntimeError
    return "failed"


def _message(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; what was learned is in checkpoint/"
    if isinstance(error, BrokenPipeError):
        return "the process that started this run is gone"
    return str(error) or type(error).__name__


def _take_standard_output() -> TextIO:
    """The stream that progress goes to; from now on what anyone prints goes to standard error."""
    stream = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    return stream


def _reporter(stream: TextIO) -> Report:
    def report(event: dict) -> None:
        stream.write(json.dumps(event) + "\n")

    return report


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
