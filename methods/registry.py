"""Which methods there are, and how one is made by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

from envgs_bench.import_path import load_import_path

from .settings import make_settings

if TYPE_CHECKING:  # composing a run does without torch, which takes longer to import than all else
    import torch

    from .method import Method

ENTRY_POINT_GROUP = "envgs_bench.methods"

BUILT_IN = {
    "2dgs": "envgs_bench.methods.two_d_gs:TwoDGS",
    "3dgs": "envgs_bench.methods.three_d_gs:ThreeDGS",
    "envmap": "envgs_bench.methods.envmap:EnvMap",
    "3dgs_dr": "envgs_bench.methods.deferred_reflection:DeferredReflection",
    "gaussian_shader": "envgs_bench.methods.gaussian_shader:GaussianShader",
    "3igs": "envgs_bench.methods.three_igs:ThreeIGS",
    "ref_gaussian": "envgs_bench.methods.ref_gaussian:RefGaussian",
    "ref_gs": "envgs_bench.methods.ref_gs:RefGS",
    "rt_splatting": "envgs_bench.methods.rt_splatting:RTSplatting",
    "envgs": "envgs_bench.methods.envgs:EnvGS",
    "envgs_single_set": "envgs_bench.methods.single_set:SingleSet",
}

SETTINGS = {  # of the methods built in, where composing a run finds them without their classes
    "2dgs": "envgs_bench.methods.settings:TwoDGSSettings",
    "3dgs": "envgs_bench.methods.settings:ThreeDGSSettings",
    "envmap": "envgs_bench.methods.lighting.settings:EnvMapSettings",
    "3dgs_dr": "envgs_bench.methods.lighting.settings:DeferredReflectionSettings",
    "gaussian_shader": "envgs_bench.methods.lighting.settings:GaussianShaderSettings",
    "3igs": "envgs_bench.methods.lighting.settings:ThreeIGSSettings",
    "ref_gaussian": "envgs_bench.methods.lighting.settings:RefGaussianSettings",
    "ref_gs": "envgs_bench.methods.lighting.settings:RefGSSettings",
    "rt_splatting": "envgs_bench.methods.lighting.settings:RTSplattingSettings",
    "envgs": "envgs_bench.methods.lighting.settings:EnvGSSettings",
    "envgs_single_set": "envgs_bench.methods.lighting.settings:ReflectionSettings",
}


def installed_methods() -> dict[str, EntryPoint]:
    """The methods that installed packages register, by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def method_paths() -> dict[str, str]:
    """The import paths of the kinds that `create_method` knows by name: built in, or of installed packages."""
    return {name: point.value for name, point in installed_methods().items()} | BUILT_IN


def method_names() -> list[str]:
    """The kinds that `create_method` knows by name."""
    return sorted(method_paths())


def create_method(
    kind: str, settings: Mapping[str, Any] | None = None, device: torch.device | str = "cpu", seed: int = 0
) -> Method:
    """A new method.

    Args:
        kind: a name of `method_names()` or an import path "package.module:Class".
        settings: overrides of the method's `Settings`, by field name.
        device: where it trains and renders.
        seed: for everything random in it.

    Raises:
        ValueError: no such method, not a `Method`, or a setting it does not have.
    """
    found = method_class(kind)
    return found(make_settings(found.Settings, settings or {}, f"method {kind}: "), device, seed)


def settings_type(kind: str) -> type:
    """The settings dataclass of the class that `method_class` returns, or raises for."""
    if kind in SETTINGS:
        found: type = load_import_path(SETTINGS[kind])
        return found
    return method_class(kind).Settings


def method_class(kind: str) -> type[Method]:
    """The class that `create_method` makes methods of.

    Raises:
        ValueError: no such method, or not a `Method`.
    """
    path = BUILT_IN.get(kind, kind)
    if ":" not in path:
        path = method_paths().get(kind, kind)  # looks through all that is installed
    if ":" not in path:
        raise ValueError(
            f"unknown method {kind!r}: the known ones are {', '.join(method_names())}; "
            "one of your own is given as an import path, package.module:Class"
        )
    try:
        found = load_import_path(path)
    except ImportError as error:
        place = f" from {path}" if path != kind else ""
        raise ValueError(f"method {kind!r} cannot be imported{place}: {error}") from error
    from .method import Method

    if not (isinstance(found, type) and issubclass(found, Method)):
        raise ValueError(f"method {kind!r}: {path} is not a subclass of envgs_bench.methods.method.Method")
    return found
