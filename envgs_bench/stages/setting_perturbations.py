"""Perturbations of settings: what an unlucky choice of them does to a method, whichever it is."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from envgs_bench.datasets.perturbations.perturbation import Perturbation
from envgs_bench.methods.registry import settings_type
from envgs_bench.methods.settings import LEARNING_RATES
from envgs_bench.records import ELSEWHERE
from envgs_bench.settings import RunSettings, SettingsError

MIN_PIXELS = 16  # a toy picture's smallest edge: LPIPS is defined from there on


def _scale_rates(settings: RunSettings, factor: float, rng: np.random.Generator) -> RunSettings:
    own = _method_settings(settings)
    return _with_method(settings, {key: factor * value for key, value in own.items() if key.endswith(LEARNING_RATES)})


def _scale_scale_rate(settings: RunSettings, factor: float, rng: np.random.Generator) -> RunSettings:
    return _with_method(settings, {"scale_lr": factor * _required(settings, "scale_lr")})


def _limit_sizes(settings: RunSettings, most: float, rng: np.random.Generator) -> RunSettings:
    _required(settings, "max_primitives")
    limits = [key for key in _method_settings(settings) if key.endswith("max_primitives")]
    return _with_method(settings, dict.fromkeys(limits, int(most)))


def _without_resets(settings: RunSettings, never: float, rng: np.random.Generator) -> RunSettings:
    _required(settings, "opacity_reset_every")
    return _with_method(settings, {"opacity_reset_every": int(never)})


def _without_joint(settings: RunSettings, off: float, rng: np.random.Generator) -> RunSettings:
    _required(settings, "joint")
    return _with_method(settings, {"joint": bool(off)})


def _blend_normals(settings: RunSettings, off: float, rng: np.random.Generator) -> RunSettings:
    rules = _required(settings, "rules")
    return _with_method(settings, {"rules": {**rules, "normal_rendered": "blended", "normal_reference": "unit"}})


def _scale_steps(settings: RunSettings, factor: float, rng: np.random.Generator) -> RunSettings:
    return settings.model_copy(update={"steps": max(1, round(factor * settings.steps))})


def _resize(settings: RunSettings, factor: float, rng: np.random.Generator) -> RunSettings:
    given = settings.dataset
    if "width" in given and "height" in given:
        size = {key: max(MIN_PIXELS, round(factor * given[key])) for key in ("width", "height")}
    else:
        size = {"downsample": max(1.0, given.get("downsample", 1.0) / factor)}
    return settings.model_copy(update={"dataset": {**given, **size}})


def _method_settings(settings: RunSettings) -> dict[str, Any]:
    if settings.method.kind in ELSEWHERE:
        raise SettingsError(f"method {settings.method.kind}: another program's settings are its own, none is perturbed")
    defaults = dataclasses.asdict(settings_type(settings.method.kind)())
    return {**defaults, **settings.method.settings}


def _required(settings: RunSettings, key: str) -> Any:
    own = _method_settings(settings)
    if key not in own:
        raise SettingsError(f"method {settings.method.name} has no setting {key}, which the perturbation changes")
    return own[key]


def _with_method(settings: RunSettings, changes: dict[str, Any]) -> RunSettings:
    method = settings.method.model_copy(update={"settings": {**settings.method.settings, **changes}})
    return settings.model_copy(update={"method": method})


PERTURBATIONS: dict[str, Perturbation[RunSettings]] = {
    "rates_up": Perturbation(_scale_rates, (3.0, 10.0, 30.0), "all learning rates × {:g}"),
    "rates_down": Perturbation(_scale_rates, (1 / 3, 1 / 10, 1 / 30), "all learning rates × {:.2g}"),
    "scale_rate_up": Perturbation(_scale_scale_rate, (3.0, 10.0, 30.0), "the scales' learning rate × {:g}"),
    "size_limit": Perturbation(_limit_sizes, (5000, 2000, 1000), "at most {:,} primitives in a set"),
    "no_resets": Perturbation(_without_resets, (0,), "no resets of the base set's opacities"),
    "no_joint": Perturbation(_without_joint, (0,), "no joint optimization"),
    "blended_normals": Perturbation(_blend_normals, (0,), "L_norm takes normals as they are blended, as long as alpha"),
    "steps_fewer": Perturbation(_scale_steps, (1 / 3, 1 / 10, 1 / 30), "steps × {:.2g}"),
    "steps_more": Perturbation(_scale_steps, (3.0, 10.0, 100 / 3), "steps × {:.3g}"),
    "pixels_fewer": Perturbation(_resize, (3 / 4, 1 / 2, 2 / 5), "pictures {:g} × as wide"),
    "pixels_more": Perturbation(_resize, (2.0, 4.0, 10.0), "pictures {:g} × as wide"),
}
