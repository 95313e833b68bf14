"""Settings: what Gaussian methods share, and how plain values become a method's settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class GaussianSettings:
    """Settings that all Gaussian methods share. Steps are those of a run of 30,000 (see `Schedule`)."""

    backend: str = "auto"  # of the core: auto, cpu, cuda, torch
    near: float = 0.2  # hits nearer to the camera are not drawn, world units
    sh_degree: int = 2  # of the view-dependent color, 0 to 3
    sh_every: int = 0  # steps after which another SH degree is added; 0: all from the start

    position_lr: float = 1.6e-4  # × scene radius, at the start; log-linear to
    position_lr_final: float = 1.6e-6  # × scene radius, at the end
    sh_lr: float = 2.5e-3  # of the constant term; 1/20 of it for the rest
    opacity_lr: float = 5e-2
    scale_lr: float = 5e-3
    rotation_lr: float = 1e-3  # at the start; log-linear to
    rotation_lr_final: float = 1e-3  # at the end

    initial_opacity: float = 0.1
    densify_from: int = 500
    densify_until: int = 15_000
    densify_every: int = 100
    densify_threshold: float = 2e-4  # gradient of the projected center, in half images
    min_coverage: float = 1.0  # pixels that a primitive must fill, on average over its views, to be cloned or split
    min_views: float = 3.0  # steps since the last densification that must have shown it for that, by its weights
    min_opacity: float = 0.05  # pruned below
    max_primitives: int = 1_800_000
    opacity_reset_every: int = 3_000  # 0: never

    normal_weight: float = 0.04  # of L_norm, rendered normals against those of the depth map
    normal_from: int = 0  # step after which it counts
    mono_weight: float = 0.01  # of L_mono, against the view's own normals where it has any
    mono_loss: str = "cos"  # 1 − cos (paper), or l1_cos: the L1 distance beside it (released code)
    normal_weighting: str = "none"  # of both normal losses' pixels: none, depth (near ones count more), alpha
    perceptual_weight: float = 0.01  # of L_perc, where the harness provides it
    perceptual_from: int = 0


def make_settings(settings_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """`values` as an instance of the dataclass `settings_type`.

    Raises:
        ValueError: a key is not one of its fields, or a value has another type than the default; the message lists
            the known keys.
    """
    known = {field.name: field for field in dataclasses.fields(settings_type)}
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ValueError(f"{owner} has no setting {', '.join(unknown)}; its settings are {', '.join(sorted(known))}")
    return settings_type(**{key: _checked(owner, key, value, known[key].default) for key, value in values.items()})


def _checked(owner: str, key: str, value: Any, default: Any) -> Any:
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        expected = type(default).__name__
        raise ValueError(
            f"{owner}: setting {key} is {value!r}, expected a value of type {expected} such as {default!r}"
        )
    return value
