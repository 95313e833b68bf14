"""Settings: what Gaussian methods share, how plain values become a method's settings, and what their comments say."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import statistics
import textwrap
import tokenize
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

LEARNING_RATES = ("_lr", "_lr_final")  # how the names of settings end that are learning rates


@dataclass(frozen=True)
class GaussianSettings:
    """Settings that all Gaussian methods share. Steps are those of a run of 30,000 (see `Schedule`)."""

    backend: str = "auto"  # backend of the core: auto, cpu, cuda, torch
    near: float = 0.2  # hits nearer to the camera are not drawn, world units; a scene's free space raises it
    sh_degree: int = 2  # degree of the view-dependent color's spherical harmonics, 0 to 3
    sh_every: int = 0  # steps after which another SH degree is added; 0: all at once
    sh_from: int = 0  # step up to which the base set's color is the same from everywhere, SH degree 0

    stretches: bool = True  # a run of more than 30,000 steps stretches the schedule; false: it goes on after its end
    longest_run: int = 0  # a run that is given more steps ends after so many; 0: every run is as long as it is given

    position_lr: float = 1.6e-4  # positions' learning rate × scene radius at the start; log-linear to position_lr_final
    position_lr_final: float = 1.6e-6  # positions' learning rate × scene radius at the end
    sh_lr: float = 2.5e-3  # learning rate of the spherical harmonics' constant term; 1/20 of it for the others
    opacity_lr: float = 5e-2  # learning rate of the opacities' logits
    scale_lr: float = 5e-3  # learning rate of the scales' logarithms
    rotation_lr: float = 1e-3  # learning rate of the quaternions at the start; log-linear to rotation_lr_final
    rotation_lr_final: float = 1e-3  # learning rate of the quaternions at the end

    exposure: str = (
        "none"  # none, or affine: a map of color for each training view, learned along; test views have none
    )

    average_from: int = 27_600  # step after which all that is trained is averaged; a run ends with that; 0: never

    initial_opacity: float = 0.1  # opacity that all primitives start with
    initial_orientation: str = "surface"  # of the base set: along the surface of the points, random, or world (axes)
    densify_from: int = 500  # step after which the base set is densified
    densify_until: int = 15_000  # step before which densification and opacity resets end
    densify_every: int = 100  # steps between the base set's densifications
    densify_threshold: float = 2e-4  # gradient of the projected center, in half images
    mean_gradient_over: str = "drawn"  # steps of its mean: that drew the primitive, or had it in_view, hidden or not
    mean_gradient_of: str = "all"  # whose gradient it is: all, or own: without what anti-aliasing draws of a surfel
    max_growth: float = 0.1  # most that either way of growing adds to a set at once, × its size; 0: no limit
    min_coverage: float = 1.0  # pixels that a primitive must fill, on average over its views, to be cloned or split
    min_views: float = 3.0  # primitives that fewer steps since the last densification show are not cloned or split
    min_opacity: float = 0.05  # primitives below are pruned
    max_scale: float = 0.5  # most of a scale after an opacity reset, × the distance to a camera that shows it; 0: any
    oversized: str = "split"  # above a tenth of the radius: split (in five), or prune (from the first opacity reset on)
    max_primitives: int = 1_800_000  # largest base set; beyond, those of the least blending weight are pruned; 0: any
    pixels_per_primitive: float = 0.0  # the base set has at most a primitive for so many training pixels; 0: no bound
    opacity_reset_every: int = 3_000  # steps between the base set's opacity resets; 0: never
    prune_error: float = 0.0  # a pruning removes what adds so much to the training views' squared error; 0: none
    prune_from: int = 21_000  # step after which there are prunings, of all sets together
    prune_until: int = 28_000  # step before which they end
    prune_every: int = 1_500  # steps between two of them
    reset_on_white: bool = False  # over a white background, opacities are also reset at densify_from

    normal_weight: float = 0.04  # weight of L_norm, rendered normals against those of the depth map
    normal_from: int = 0  # step after which L_norm counts
    normal_reference: str = "unit"  # depth map's normals in L_norm: unit, or alpha: × the pixel's alpha (2DGS's code)
    normal_rendered: str = "unit"  # rendered normals in L_norm: unit, or blended: as they are, which pulls at alpha too
    mono_weight: float = 0.01  # weight of L_mono, rendered normals against the view's own where it has any
    normals: str = "agreed"  # the views' own, in L_mono: as_given, or agreed: turned to agree, and weighed by that
    mono_loss: str = "cos"  # cos: 1 − cos (paper); l1_cos: the L1 distance beside it (released code)
    mono_rendered: str = "blended"  # rendered normals in L_mono: blended, as they are, or unit: normalized
    mono_from: int = 0  # step after which L_mono counts
    normal_weighting: str = "none"  # weights of pixels in both normal losses: none, depth (near ones more), or alpha
    perceptual_weight: float = 0.01  # weight of L_perc, where the harness provides it
    perceptual_loss: str = "features"  # L_perc: features, the L1 distance of VGG-16's (paper), or lpips (released code)
    perceptual_from: int = 0  # step after which L_perc counts


@dataclass(frozen=True)
class PublishedSettings(GaussianSettings):
    """What 3DGS and 2DGS share of their released code: its adaptive control, its colors and its 30,000 steps."""

    sh_degree: int = 3
    sh_every: int = 1_000

    longest_run: int = 30_000
    average_from: int = 0
    normals: str = "as_given"

    mean_gradient_over: str = "in_view"
    mean_gradient_of: str = "own"
    max_growth: float = 0.0
    min_coverage: float = 0.0
    min_views: float = 0.0
    max_scale: float = 0.0
    oversized: str = "prune"
    max_primitives: int = 0
    reset_on_white: bool = True


def make_settings(settings_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """`values` as an instance of the dataclass `settings_type`.

    Raises:
        ValueError: a key is not one of its fields, or a value has another type than the default; the message lists
            the known keys.
    """
    defaults = settings_type()
    known = {field.name for field in dataclasses.fields(settings_type)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(f"{owner} has no setting {', '.join(unknown)}; its settings are {', '.join(sorted(known))}")
    return settings_type(**{key: _checked(owner, key, value, getattr(defaults, key)) for key, value in values.items()})


def quickness(settings: Any) -> float:
    """How quickly a method learns beside its own rates: the median of its rates over their defaults, at most 1.

    So a recipe that lowers one rate is not slow, and one that lowers all of them is. 1 where there are no rates.
    """
    own, usual = dataclasses.asdict(settings), dataclasses.asdict(type(settings)())
    ratios = [own[name] / usual[name] for name in own if name.endswith(LEARNING_RATES) and usual[name] > 0]
    return min(1.0, statistics.median(ratios or [1.0]))


def check_words(settings: Any, words: Mapping[str, Sequence[str]]) -> None:
    """Raise a ValueError that names the setting where one of those in `words` is none of its words."""
    for name, known in words.items():
        if getattr(settings, name) not in known:
            raise ValueError(f"{name} is {getattr(settings, name)!r}, expected {' or '.join(known)}")


def _checked(owner: str, key: str, value: Any, default: Any) -> Any:
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(default, tuple) and isinstance(value, list):
        return tuple(value)
    if default is not None and type(value) is not type(default):
        expected = type(default).__name__
        raise ValueError(
            f"{owner}: setting {key} is {value!r}, expected a value of type {expected} such as {default!r}"
        )
    return value


def setting_comments(settings_type: type) -> dict[str, str]:
    """The comment behind each field of a settings dataclass, by the field's name.

    A subclass that changes a default and adds no comment leaves the one it inherits. Fields without a comment, and
    those of classes whose source is not to be had, are left out.
    """
    found: dict[str, str] = {}
    for owner in reversed(settings_type.__mro__):
        if dataclasses.is_dataclass(owner):
            found |= _trailing_comments(owner)
    return {field.name: found[field.name] for field in dataclasses.fields(settings_type) if field.name in found}


def _trailing_comments(owner: type) -> dict[str, str]:
    """The comments at the end of the fields that the body of the class itself declares."""
    try:
        source = textwrap.dedent(inspect.getsource(owner))
        (definition,) = ast.parse(source).body
    except (OSError, TypeError, SyntaxError):
        return {}
    assert isinstance(definition, ast.ClassDef)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    by_line = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    return {
        node.target.id: by_line[node.end_lineno]
        for node in definition.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.end_lineno in by_line
    }
