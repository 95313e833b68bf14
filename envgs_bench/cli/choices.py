"""Choices of a run: whether there is what its settings ask for."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile

from envgs_bench.datasets.errors import unwritable
from envgs_bench.datasets.registry import check_source, is_cached
from envgs_bench.loggers.opening import require_logger
from envgs_bench.methods.registry import settings_type
from envgs_bench.methods.settings import make_settings
from envgs_bench.metrics import WeightsUnavailable, find_weights, get_protocol
from envgs_bench.records import ELSEWHERE, RENDERS
from envgs_bench.runs.job import resolve_device
from envgs_bench.settings import RunSettings, SettingsError
from envgs_bench.stages.perturbations import perturbation_of, perturbed_settings


def check_choices(settings: RunSettings) -> None:
    """Raise a SettingsError where a run with these settings asks for what there is not, whatever its data are."""
    try:
        get_protocol(settings.protocol)
    except ValueError as error:
        raise SettingsError(f"protocol={settings.protocol}: {error}") from error
    perturbation_of(settings)  # refuses a kind or a severity that there is not,
    actual = perturbed_settings(settings)  # and one that changes what the method does not have
    if actual.budget is not None:
        from envgs_bench.stages.budget import check_budget  # with torch: only the method knows what it takes

        check_budget(actual)
    require_logger(settings)


def check_run(settings: RunSettings) -> None:
    """Refuse settings with which no run can start on this machine, with these data.

    Raises:
        DatasetError: it is the data.
        SettingsError: it is anything else.
    """
    check_choices(settings)
    resolve_device(settings.device)
    actual, kind = perturbed_settings(settings), settings.method.kind
    check_source(actual.dataset)
    _check_cache(actual)
    if kind == RENDERS and not Path(str(settings.method.settings.get("path"))).exists():
        raise SettingsError(f"path={settings.method.settings.get('path')}: there is no such folder of renders")
    if kind not in ELSEWHERE:
        try:
            make_settings(settings_type(kind), actual.method.settings, f"method {kind}: ")
        except ValueError as error:
            raise SettingsError(str(error)) from error


def check_page(folder: Path) -> None:
    """Raise a SettingsError where the live page would replace one of something else."""
    from envgs_bench.reports.outputs import require_no_others_page  # with pandas

    try:
        require_no_others_page(folder)
    except (OSError, ValueError) as error:
        raise SettingsError(f"page={error}") from error


def _check_cache(settings: RunSettings) -> None:
    """A cache that others fill is read; one that lacks the scene and cannot be written would have each run make it."""
    folder = settings.cache_dir
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        if not _is_cached(json.dumps(settings.dataset, sort_keys=True, default=str), folder):
            why = unwritable(f"cache_dir={folder}", error, settings.dataset_name, "its scene")
            raise SettingsError(why) from error


@cache  # methods and seeds of a sweep share their scenes
def _is_cached(dataset: str, folder: Path) -> bool:
    return is_cached(json.loads(dataset), folder)


def tell_of_weights() -> None:
    """Say on standard error what a run does without where VGG-16's weights are not to be had."""
    try:
        find_weights()
    except WeightsUnavailable as error:
        print(f"LPIPS will read n/c, and no perceptual loss is trained with: {error}", file=sys.stderr)
