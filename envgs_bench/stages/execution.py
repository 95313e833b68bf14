"""Execution: all that a run does, in order, each part's result kept as soon as it is there."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import numpy as np
import torch

from envgs_bench.core import Scene
from envgs_bench.core.cuda.compiler import keep_kernels_in
from envgs_bench.datasets.notes import collecting, note
from envgs_bench.datasets.progress import listening
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import repaired
from envgs_bench.diagnosis.scene_warnings import scene_warnings
from envgs_bench.fixed_rays import write_samples
from envgs_bench.methods.method import Method
from envgs_bench.methods.settings import quickness
from envgs_bench.metrics import MINIMUM_SIZE, Protocol, WeightsUnavailable, get_protocol, make_perceptual_loss
from envgs_bench.parts import PERCEPTUAL
from envgs_bench.records import RENDERS, WorldPlacement
from envgs_bench.run_folder import CHECKPOINT, CURVE_NAME
from envgs_bench.settings import RunSettings

from .budget import limited_method
from .cost import cost_of, with_files
from .evaluation import evaluate, scored_views
from .events import EventListener
from .fixed_rays import sampled
from .perturbations import load_run_scene, perturbed_settings
from .renders import score_renders
from .results import Results
from .snapshots import Snapshots
from .stop import Stop
from .timing import time_frames
from .training import Training
from .training_log import Logger, TrainingLog
from .vector_functions import call_each_once

FEW_VIEWS = 12  # sparse-view methods are made for fewer


def execute(
    settings: RunSettings,
    folder: Path,
    results: Results,
    report: EventListener,
    stop: Stop | None = None,
    logger: Logger | None = None,
) -> None:
    """Train, draw, score and time as `settings` say; pictures, curve, checkpoint and samples go into `folder`.

    A training that was interrupted in `folder` goes on. `stop` may ask for its end while it trains; `logger` is told
    how it goes, as often as `settings.logger` says.

    Raises:
        Diverged: nothing more can be learned, or a render is not finite.
        MemoryError: hardly any memory is left.
        ValueError, OSError: settings or data that cannot be used.
    """
    call_each_once()
    keep_kernels_in(settings.cache_dir / "kernels")
    _seed(settings.seed)
    protocol = get_protocol(settings.protocol)
    if settings.method.kind == RENDERS:
        _score_renders(settings, folder, results, protocol, report)
        return
    actual = perturbed_settings(settings)
    method = limited_method(actual, settings.device)
    offer_perceptual_loss(method)
    scene = _load(settings, results, report)
    check_scene(scene)
    results.steps = method.training_steps(actual.steps)
    diagnosis = Diagnosis(scene, method.device)
    if len(scene.points):  # a method refuses others
        results.warnings = scene_warnings(diagnosis, results.steps, quickness(method.settings), near_of(method, scene))
        diagnosis, results.repairs = repaired(diagnosis, settings.repair, settings.seed)
        scene = scene_for(method, diagnosis)
    for warning in results.warnings:
        report({"stage": "training", "step": 0, "steps": results.steps, "warning": warning.model_dump()})
    if results.repairs:
        told = [f"repair of {outcome.kind}: {outcome.message}" for outcome in results.repairs]
        results.notes = [*results.notes, *told]
        report({"stage": "training", "step": 0, "steps": results.steps, "notes": told})
    log = None
    if logger and settings.logger:
        log = TrainingLog(logger, method, scene, settings.logger.every, settings.logger.views)
    training = Training(method, scene, results.steps, settings.seed, log)
    stop = stop or Stop()
    snapshots = Snapshots(folder, settings.snapshot_minutes, stop)
    try:
        with stop.deferred():
            training.run(folder / CURVE_NAME, report, snapshots)
    finally:
        results.went_on_from = training.went_on_from
        results.losses = sorted(training.losses)
        results.dropped_losses = dict(method.dropped_losses)
        results.notes = [*results.notes, *method.notes]
        results.warnings = [*results.warnings, *training.health.warnings]
        if training.step:  # however it ends, what was learned is kept
            results.cost = cost_of(method, training)
            method.save(folder / CHECKPOINT)
    # Now: what the scoring takes of memory is not the training's.
    results.cost = with_files(cost_of(method, training), method, folder / CHECKPOINT)
    report({"stage": "preparing"})
    method.prepare()
    views = scored_views(scene, settings.score_on)
    results.metrics, results.masked = evaluate(method, views, protocol, folder, report)
    report({"stage": "timing"})
    results.timing = time_frames(method, views, settings.timing)
    write_samples(folder, sampled(method, scene, views))
    snapshots.remove()


def _score_renders(
    settings: RunSettings, folder: Path, results: Results, protocol: Protocol, report: EventListener
) -> None:
    """The run of a method whose pictures come from elsewhere: nothing is trained, drawn or timed."""
    results.steps = 0
    scene = _load(settings, results, report)
    check_scene(scene)
    views, background = scored_views(scene, settings.score_on), scene.background
    scored = score_renders(settings.method.settings, views, background, protocol, folder, report, settings.device)
    results.metrics, results.masked = scored


def _load(settings: RunSettings, results: Results, report: EventListener) -> Scene:
    """The run's scene; making one for the first time may take minutes, and its source says how far it has come."""
    report({"stage": "loading"})
    tell = lambda stage, done, total: report({"stage": stage, "step": done, "steps": total})  # noqa: E731
    with listening(tell), collecting() as notes:
        scene = load_run_scene(settings)
        if len(scene.train) < FEW_VIEWS and settings.method.kind != RENDERS:
            note(f"data set {scene.name} has only {len(scene.train)} training views, of which little can be learned")
    results.dataset, results.notes = scene.name, notes
    results.placement = WorldPlacement(shift=scene.placement.shift, scale=scene.placement.scale)
    if notes:
        report({"stage": "loading", "notes": notes})
    return scene


def near_of(method: Method, scene: Scene) -> float:
    """What the method draws nothing nearer than in this scene, world units."""
    return max(method.needs.clearance, scene.free_space)


def check_scene(scene: Scene) -> None:
    """Refuse, before anything is trained, what could not be trained on or not be scored at the end."""
    for name, views in (("training", scene.train), ("test", scene.test)):
        if not views:
            raise ValueError(f"data set {scene.name} has no {name} views: it needs at least two images")
    for view in (*scene.test, *scene.val):
        width, height = view.camera.width, view.camera.height
        if min(width, height) < MINIMUM_SIZE:
            raise ValueError(
                f"data set {scene.name}: view {view.name} is {width}×{height} pixels, expected at least "
                f"{MINIMUM_SIZE}×{MINIMUM_SIZE}, since metrics need them; take larger pictures, or a smaller "
                "dataset.downsample"
            )


def offer_perceptual_loss(method: Method) -> None:
    """Methods must not import metrics: those that use the perceptual loss are given it, if it can be had."""
    if name := method.needs.perceptual:
        try:
            method.perceptual = make_perceptual_loss(name, method.device)
        except WeightsUnavailable as error:
            method.dropped_losses[PERCEPTUAL] = str(error)
            print(f"training without the perceptual loss: {error}", file=sys.stderr)


def scene_for(method: Method, diagnosis: Diagnosis) -> Scene:
    """The scene as the method is given it: with what its normals are worth, where it learns from agreed ones."""
    return with_agreed_normals(diagnosis) if method.needs.agreed_normals else diagnosis.scene


def _seed(seed: int) -> None:
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (for libraries that draw from the global generator)
    torch.manual_seed(seed)
