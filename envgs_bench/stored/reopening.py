"""Reopening: a run's settings and its method with what it learned, from the run's folder."""

from __future__ import annotations

from pathlib import Path

from envgs_bench.core import Placement, Scene
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.gaussian_files import READERS
from envgs_bench.methods.storage.sog_file import META
from envgs_bench.programs.gaussians import open_gaussians
from envgs_bench.programs.recipe import parse_choice
from envgs_bench.records import EXTERNAL, RENDERS, Record, RecordError, read_record
from envgs_bench.run_folder import CHECKPOINT, CONFIG_NAME, RECORD_NAME
from envgs_bench.runs.job import resolve_device
from envgs_bench.settings import RunSettings, read_settings
from envgs_bench.stages.perturbations import load_run_scene, perturbed_settings


def reopen(folder: Path, device: str = "auto") -> tuple[RunSettings, Method]:
    """The settings of the run in `folder`, and its method, ready to `prepare` and to `render` on `device`.

    A folder without a record is opened: somebody put a model there.

    Raises:
        ValueError: the run did not end with status ok: its model is half trained, or there is none.
        RecordError: its record cannot be read.
        SettingsError, ValueError, FileNotFoundError: as `reopen_unfinished`.
    """
    record = read_record(folder) if (folder / RECORD_NAME).is_file() else None
    if record is not None and record.status != "ok":
        raise ValueError(f"{folder}: the run {_ending(record)}")
    return reopen_unfinished(folder, device)


def _ending(record: Record) -> str:
    """How a run ended that did not end ok, what is expected, and what to do."""
    if record.status == "interrupted":
        return "was interrupted; expected one that ended ok. The command that started it goes on with it"
    why = f" ({record.error})" if record.error else ""
    return f"ended as {record.status}{why}; expected one that ended ok. Mend the cause and run it with force=true"


def reopen_unfinished(folder: Path, device: str = "auto") -> tuple[RunSettings, Method]:
    """As `reopen`, however the run ended.

    Raises:
        RecordError: no run's folder.
        SettingsError: the device cannot be had.
        ValueError: another program drew the run's pictures, settings that the method does not have (any more), or a
            checkpoint of another method.
        FileNotFoundError: the run left no checkpoint.
    """
    if not (folder / CONFIG_NAME).is_file():
        raise RecordError(f"{folder}: holds no {CONFIG_NAME}; expected the folder of one run")
    settings = perturbed_settings(read_settings(folder))
    if settings.method.kind == RENDERS:
        raise ValueError(f"{folder}: another program drew its pictures, there is no model to open; take a trained run")
    if settings.method.kind == EXTERNAL:
        return settings, _program_model(folder, settings, resolve_device(device))
    method = create_method(settings.method.kind, settings.method.settings, resolve_device(device), settings.seed)
    method.load(folder / CHECKPOINT)
    return settings, method


def _program_model(folder: Path, settings: RunSettings, device: str) -> Method:
    """The Gaussians that the run's program wrote, in the world of the run's scene."""
    model = parse_choice(settings.method.settings).recipe.model
    found = sorted(path for path in (folder / CHECKPOINT).glob("*") if path.suffix in READERS or path.name == META)
    if model is None or not found:
        raise FileNotFoundError(f"{folder / CHECKPOINT}: the program left no Gaussians that could be opened")
    return open_gaussians(found[0], reopen_scene(folder, settings), model.near, device, model.centered)


def reopen_scene(folder: Path, settings: RunSettings) -> Scene:
    """The scene of the run in `folder`, in whose world its model is.

    Raises:
        RecordError, DatasetError: as `read_record` and `load_run_scene`.
        ValueError: the model was trained in another world of these data, as an older version placed it.
    """
    scene = load_run_scene(settings)
    trained = placement_of(folder)
    if trained is not None and trained != scene.placement:
        raise ValueError(
            f"{folder}: its model was trained where a place of the data is {trained}, and these data are now read "
            f"where it is {scene.placement}; run it again"
        )
    return scene


def placement_of(folder: Path) -> Placement | None:
    """Where the world of the run's model lies in that of its data; None where the run left no record.

    Raises:
        RecordError: as `read_record`.
    """
    if not (folder / RECORD_NAME).is_file():
        return None
    stored = read_record(folder).placement
    return Placement() if stored is None else Placement(stored.shift, stored.scale)
