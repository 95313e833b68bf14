"""Perturbations of a run: of its scene, as it is read, or of its settings, before anything is made of them.

Whatever a run is perturbed in, its record holds the settings that it would have had without, and the perturbation
beside them: a perturbed run and its unperturbed partner differ in nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envgs_bench.datasets.perturbations.perturbation import Perturbation
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS as OF_SCENES
from envgs_bench.datasets.registry import load_scene
from envgs_bench.records import Perturbed
from envgs_bench.settings import RunSettings, SettingsError

from .setting_perturbations import PERTURBATIONS as OF_SETTINGS

if TYPE_CHECKING:
    from envgs_bench.core import Scene


def load_run_scene(settings: RunSettings) -> Scene:
    """The scene of a run with these settings, as given, perturbed where the run is; the cache holds what is not.

    Raises:
        DatasetError: as `load_scene`, or the scene lacks what is to be perturbed.
    """
    scene = load_scene(perturbed_settings(settings).dataset, settings.cache_dir)
    chosen = settings.perturb
    if chosen is None or chosen.kind not in OF_SCENES:
        return scene
    return OF_SCENES[chosen.kind].applied(scene, chosen.severity, chosen.kind, settings.seed)


def perturbed_settings(settings: RunSettings) -> RunSettings:
    """The settings that the run goes by: other than those given where its perturbation is one of settings."""
    chosen = settings.perturb
    if chosen is None or chosen.kind not in OF_SETTINGS:
        return settings
    return OF_SETTINGS[chosen.kind].applied(settings, chosen.severity, chosen.kind, settings.seed)


def cameras_moved(settings: RunSettings) -> bool:
    """Whether the run's training cameras are perturbed."""
    chosen = settings.perturb
    return chosen is not None and chosen.kind in OF_SCENES and OF_SCENES[chosen.kind].moves_cameras


def perturbation_of(settings: RunSettings) -> Perturbed | None:
    """What the record says of the run's perturbation; None for an unperturbed run.

    Raises:
        SettingsError: there is no such kind, or it has no such severity.
    """
    chosen = settings.perturb
    if chosen is None:
        return None
    known: dict[str, Perturbation[Any]] = {**OF_SCENES, **OF_SETTINGS}
    if chosen.kind not in known:
        raise SettingsError(f"perturb.kind={chosen.kind!r}: expected none, {', '.join(known)}")
    kind = known[chosen.kind]
    if chosen.severity > len(kind.levels):
        raise SettingsError(
            f"perturb.severity={chosen.severity}: {chosen.kind} has severities 1 to {len(kind.levels)}, and 0 for none"
        )
    return Perturbed(kind=chosen.kind, severity=chosen.severity, level=kind.level(chosen.severity))
