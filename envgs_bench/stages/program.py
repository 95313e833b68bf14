"""Program: another program's run by its recipe: data, training, pictures, and its model on the shared core."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from envgs_bench.core import Scene, View
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import repaired
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.storage.sog_file import META
from envgs_bench.metrics import Protocol
from envgs_bench.metrics.psnr import psnr
from envgs_bench.programs.command import ProgramFailed
from envgs_bench.programs.gaussians import open_gaussians
from envgs_bench.programs.memory import MemoryWatch
from envgs_bench.programs.recipe import Model, ProgramChoice, files_of, folder_of, parse_choice
from envgs_bench.programs.work import Work, commit_of
from envgs_bench.records import Cost, MaskedScores, Metrics, ProgramRun
from envgs_bench.run_folder import CHECKPOINT, PROGRAM
from envgs_bench.settings import RunSettings

from .evaluation import NORMAL_METRIC, scored_views
from .events import EventListener
from .loading import check_scene, load_for_run
from .perturbations import perturbed_settings
from .pictures import depth_unit, layer_pictures, save_pair
from .pose_alignment import ALIGNED, Alignment, alignment_of
from .renders import match_renders, read_render
from .results import Results
from .scoring import Pair, score_pairs
from .timing import time_frames

CORE = "core"  # the layer of what the shared core draws of the program's model
NOT_TOLD = "no program tells it"
LOOKED_AT = "the most that was seen, five times a second: all that its processes took, start and reading included"


def run_program(
    settings: RunSettings, folder: Path, results: Results, protocol: Protocol, report: EventListener
) -> None:
    """Have the program of the run's recipe train and draw, score its pictures, and time its model on the shared core.

    An interrupted run goes on: what was trained is not trained again, and half a training where the recipe can.

    Raises:
        RecipeError: the settings are no recipe's.
        ProgramFailed, ProgramOutOfMemory: the program ended so.
        RendersError: its pictures do not fit the scored views.
        ValueError, OSError: data that cannot be used.
    """
    choice = parse_choice(settings.method.settings)
    scene = _repaired(load_for_run(settings, results, report), settings, results)
    check_scene(scene)
    views = scored_views(scene, settings.score_on)
    results.steps = perturbed_settings(settings).steps
    work = Work(choice, (folder / PROGRAM).absolute(), results.steps, settings.seed, settings.device)
    _export(replace(scene, test=list(views) if choice.recipe.sees_test_views else [], val=()), choice, work)
    watch = MemoryWatch(settings.device, settings.memory_gb, settings.device_memory_fraction)
    try:
        report({"stage": "training", "step": 0, "steps": results.steps})
        work.train(watch, lambda step: report({"stage": "training", "step": step, "steps": results.steps}))
        report({"stage": "drawing"})
        work.draw(watch)
    finally:  # however it ends, what was measured is kept
        results.cost, results.program = _cost(work), _program(choice, work)
    report({"stage": "preparing"})
    method, why = _drawn_by_core(choice.recipe.model, folder, work, scene, settings.device)
    if method is None and choice.recipe.pictures is None:
        raise ProgramFailed(f"it left no model that its test views could be drawn of: {why}")
    if method is not None:
        results.notes = [*results.notes, *method.notes]
        results.cost = _with_model(results.cost, method, folder / CHECKPOINT)
    alignment = alignment_of(settings, scene, protocol)
    scored, agreement = _score(choice, work, method, views, scene, protocol, folder, report, alignment)
    results.metrics, results.masked = scored
    not_measured = results.program.not_measured | ({"frame_ms": why} if why else {})
    mean = sum(agreement.values()) / len(agreement) if agreement else None
    results.program = results.program.model_copy(
        update={"agreement_db": mean, "agreement_per_view": agreement, "not_measured": not_measured}
    )
    if method is not None:
        report({"stage": "timing"})
        results.timing = time_frames(method, views, settings.timing)
    shutil.rmtree(work.data)


def _repaired(scene: Scene, settings: RunSettings, results: Results) -> Scene:
    if not settings.repair:
        return scene
    diagnosis, results.repairs = repaired(Diagnosis(scene, torch.device(settings.device)), settings.repair)
    return diagnosis.scene


def _export(scene: Scene, choice: ProgramChoice, work: Work) -> None:
    """The data as the program reads them, unless they are there from an earlier attempt."""
    if not work.data.is_dir():
        from envgs_bench.datasets.export import export_scene  # imports pycolmap, which no other run needs

        export_scene(scene, work.data, choice.recipe.layout)
    white = bool((scene.background == 1).all())
    work.values = work.values | {"on_white": choice.recipe.on_white if white else ""}


def _cost(work: Work) -> Cost:
    state = work.state
    return Cost(
        primitives={},
        bytes={},
        model_bytes=None,
        skipped_steps=None,
        peak_primitives=None,
        train_seconds=state.train_seconds,
        peak_host_bytes=state.peak_host_bytes,
        peak_device_bytes=state.peak_device_bytes,
    )


def _with_model(cost: Cost, method: GaussianMethod, checkpoint: Path) -> Cost:
    sizes = method.model_bytes()
    files = sum(path.stat().st_size for path in checkpoint.rglob("*") if path.is_file())
    counts = {"primitives": method.primitives(), "bytes": sizes, "model_bytes": sum(sizes.values())}
    return cost.model_copy(update=counts | {"checkpoint_bytes": files})


def _program(choice: ProgramChoice, work: Work) -> ProgramRun:
    recipe, state = choice.recipe, work.state
    not_measured = {"peak_primitives": NOT_TOLD, "skipped_steps": NOT_TOLD, "peak_host_bytes": LOOKED_AT}
    if state.peak_host_bytes is None:
        not_measured["peak_host_bytes"] = "it ran in a container, whose processes are not seen from here"
    if recipe.pictures is None:
        not_measured["agreement_db"] = "it draws no test views: the shared core drew those that are scored"
    if not any("{seed}" in command for command in (*recipe.train, *recipe.draw)):
        not_measured["seed"] = "its recipe passes none: runs of other seeds differ by chance alone, if at all"
    if recipe.seconds is not None and state.own_seconds is None:
        not_measured["own_seconds"] = f"nothing that it wrote matches {recipe.seconds.pattern}"
    if state.peak_device_bytes is not None:
        not_measured["peak_device_bytes"] = f"{LOOKED_AT}, on the whole GPU"
    return ProgramRun(
        page=recipe.page,
        commit=recipe.commit,
        found=commit_of(choice.home),
        licence=recipe.licence,
        tried=recipe.tried,
        commands=state.commands,
        own_seconds=state.own_seconds,
        draw_seconds=state.draw_seconds,
        not_measured=not_measured,
    )


def _drawn_by_core(
    model: Model | None, folder: Path, work: Work, scene: Scene, device: str
) -> tuple[GaussianMethod | None, str]:
    """The program's model, to be drawn by the shared core, and a copy of its file; or why there is none."""
    if model is None:
        return None, "its recipe names no file of Gaussians that the shared core could draw"
    found = files_of(model.file, work.values)
    if len(found) != 1:
        several = f": {', '.join(path.name for path in found[:3])}" if found else ""
        return None, f"{len(found)} files match {model.file}{several}; the model is expected to be one"
    kept = keep_model(found[0], folder / CHECKPOINT)
    try:
        method = open_gaussians(kept, scene, model.near, device, model.centered)
    except ValueError as error:
        return None, str(error)
    method.prepare()
    return method, ""


def keep_model(path: Path, checkpoint: Path) -> Path:
    """The file's copy in the folder; of a SOG's meta.json, what lies beside it too."""
    shutil.rmtree(checkpoint, ignore_errors=True)
    if path.name == META:
        shutil.copytree(path.parent, checkpoint)
    else:
        checkpoint.mkdir(parents=True)
        shutil.copyfile(path, checkpoint / path.name)
    return checkpoint / path.name


def _score(
    choice: ProgramChoice,
    work: Work,
    method: GaussianMethod | None,
    views: Sequence[View],
    scene: Scene,
    protocol: Protocol,
    folder: Path,
    report: EventListener,
    alignment: Alignment | None,
) -> tuple[tuple[Metrics, dict[str, MaskedScores]], dict[str, float]]:
    """Scores of its pictures, and each view's agreement with the shared core's picture of its model, dB.

    Of a program that draws no test views the core's pictures are scored.
    """
    pictures = choice.recipe.pictures
    files = {}
    if pictures is not None:
        found = files_of(pictures.files, work.values)
        folder_of_them = folder_of(pictures.files, work.values) if found else work.output
        files = match_renders(folder_of_them, pictures.match, views, found, pictures.crop)
    unit = depth_unit([view.camera for view in views])
    agreement: dict[str, float] = {}

    def pairs() -> Iterator[Pair]:
        for number, view in enumerate(views):
            report({"stage": "scoring", "step": number, "steps": len(views)})
            image, layers, others = None, {}, {}
            if pictures is not None:
                image = read_render(files[view.name], scene.background, pictures.crop)
            if method is not None:
                rendering = method.render(view.camera.to(method.device))
                ours = rendering.color.cpu()
                layers = layer_pictures(rendering, unit) | {CORE: ours}
                if image is not None:
                    agreement[view.name] = psnr(image.clamp(0, 1), ours.clamp(0, 1))
                if image is None:
                    image, others = ours, alignment.scores(method, view) if alignment else {}
            assert image is not None
            save_pair(folder, view, image, layers)
            yield Pair(view.name, image, view.rgb(), view.masks, others)

    metrics, masked = score_pairs(pairs(), protocol, method.device if method else "cpu")
    why = {NORMAL_METRIC: "another program's normals are not known"}
    if alignment and pictures is not None:
        why[ALIGNED] = "another program's pictures cannot be drawn from elsewhere"
    return (metrics.model_copy(update={"not_computed": {**metrics.not_computed, **why}}), masked), agreement
