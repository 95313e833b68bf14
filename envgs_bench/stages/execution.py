"""Execution: all that a run does, in order, each part's result kept as soon as it is there."""

from __future__ import annotations

import random
import sys
from functools import partial
from pathlib import Path

import numpy as np
import torch

from envgs_bench.core import Scene
from envgs_bench.core.cuda.compiler import keep_kernels_in
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import repaired
from envgs_bench.diagnosis.scene_warnings import scene_notes, scene_warnings
from envgs_bench.fixed_rays import write_samples
from envgs_bench.methods.method import Method
from envgs_bench.methods.settings import quickness
from envgs_bench.metrics import WeightsUnavailable, get_protocol, make_perceptual_loss
from envgs_bench.parts import GIVEN, PERCEPTUAL
from envgs_bench.records import EXTERNAL, RENDERS
from envgs_bench.run_folder import CHECKPOINT, CURVE_NAME
from envgs_bench.settings import RunSettings

from .background import Background
from .budget import FrameLimit, limited_method
from .cost import cost_of, with_files
from .evaluation import evaluate, evaluate_unseen, scored_views
from .events import EventListener
from .fixed_rays import FixedRays
from .loading import check_scene, load_for_run
from .perturbations import perturbed_settings
from .pose_alignment import alignment_of
from .program import run_program
from .renders import run_renders
from .results import Results
from .snapshots import Snapshots
from .stop import Stop
from .timing import time_frames
from .training import Training
from .training_log import Logger, TrainingLog
from .vector_functions import call_each_once

BY_OTHERS = {RENDERS: run_renders, EXTERNAL: run_program}  # the runs in which nothing of ours trains, by their kind


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
    if settings.method.kind in BY_OTHERS:
        BY_OTHERS[settings.method.kind](settings, folder, results, protocol, report)
        return
    actual = perturbed_settings(settings)
    method = limited_method(actual, settings.device)
    offer_perceptual_loss(method)
    scene = load_for_run(settings, results, report)
    check_scene(scene)
    results.steps = method.training_steps(actual.steps)
    diagnosis, told = Diagnosis(scene, method.device), []
    if len(scene.points):  # a method refuses others
        results.warnings = scene_warnings(diagnosis, results.steps, quickness(method.settings), near_of(method, scene))
        told = scene_notes(diagnosis)
        diagnosis, results.repairs = repaired(diagnosis, settings.repair)
        told += [f"repair of {outcome.kind}: {outcome.message}" for outcome in results.repairs]
        scene = scene_for(method, diagnosis)
    for warning in results.warnings:
        report({"stage": "training", "step": 0, "steps": results.steps, "warning": warning.model_dump()})
    if told:
        results.notes = [*results.notes, *told]
        report({"stage": "training", "step": 0, "steps": results.steps, "notes": told})
    log = None
    if logger and settings.logger:
        log = TrainingLog(logger, method, scene, settings.logger.every, settings.logger.views)
    frames = None
    if actual.budget and actual.budget.frame_ms:
        frames = FrameLimit(method, actual.budget, scene, results.steps)
    training = Training(method, scene, results.steps, settings.seed, log, frames)
    views = scored_views(scene, settings.score_on)
    stop = stop or Stop()
    snapshots = Snapshots(folder, settings.snapshot_minutes, stop)
    try:
        with stop.deferred():
            training.run(folder / CURVE_NAME, report, snapshots)
        if frames:
            report({"stage": "timing"})
            results.timing = frames.hold(partial(time_frames, method, views, settings.timing))
            results.notes = [*results.notes, frames.sentence]
    finally:
        results.went_on_from = training.went_on_from
        results.losses = sorted(training.losses)
        results.dropped_losses = dict(method.dropped_losses)
        results.given = given_of(scene, method)
        results.notes = [*results.notes, *method.notes]
        results.warnings = [*results.warnings, *training.health.warnings]
        if training.step:  # however it ends, what was learned is kept
            results.cost = cost_of(method, training)
            method.save(folder / CHECKPOINT)
    results.cost = cost_of(method, training)  # now: what the scoring takes of memory is not the training's
    alignment, rays = alignment_of(settings, scene, protocol), FixedRays(views)
    with Background(method.device) as background:
        packing = background.begin(with_files, results.cost, method, folder / CHECKPOINT)
        try:
            report({"stage": "preparing"})
            method.prepare()
            results.metrics, results.masked = evaluate(method, views, protocol, folder, report, alignment, rays.see)
            if settings.score_on == "test":
                results.unseen = evaluate_unseen(method, scene, protocol, folder, report)
        finally:
            results.cost = packing.result()
    if not frames:  # of a budget of frames, those that decided are the record's
        report({"stage": "timing"})
        results.timing = time_frames(method, views, settings.timing)
    write_samples(folder, rays.samples(method, scene.radius))
    snapshots.remove()


def near_of(method: Method, scene: Scene) -> float:
    """What the method draws nothing nearer than in this scene, world units."""
    return max(method.needs.clearance, scene.free_space)


def offer_perceptual_loss(method: Method) -> None:
    """Methods must not import metrics: those that use perceptual losses are given them, if they can be had.

    What a method trains without is said at once; what it does without LPIPS, it says itself.
    """
    needs = method.needs
    for name in filter(None, dict.fromkeys([needs.perceptual, "lpips" if needs.lpips else None])):
        try:
            method.perceptual[name] = make_perceptual_loss(name, method.device)
        except WeightsUnavailable as error:
            if name == needs.perceptual:
                method.dropped_losses[PERCEPTUAL] = str(error)
                print(f"training without the perceptual loss: {error}", file=sys.stderr)


def scene_for(method: Method, diagnosis: Diagnosis) -> Scene:
    """The scene as the method is given it: with what its normals are worth, where it learns from agreed ones."""
    return with_agreed_normals(diagnosis) if method.needs.agreed_normals else diagnosis.scene


def given_of(scene: Scene, method: Method) -> list[str]:
    """What the method uses of the scene's data besides photographs, poses and points, in words."""
    there = {
        "normals": any(view.normal is not None for view in scene.train),
        "masks": any(mask.any() for view in scene.train for mask in view.masks.values()),
    }
    return [GIVEN[name] for name in method.needs.given if there.get(name, True)]


def _seed(seed: int) -> None:
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (for libraries that draw from the global generator)
    torch.manual_seed(seed)
