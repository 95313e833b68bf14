"""Composes a data set as a run would, loads it, writes it in another layout, and reads that back."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from envgs_bench.core import Camera, Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.export import export_scene
from envgs_bench.datasets.progress import listening
from envgs_bench.runs.display import make_display
from envgs_bench.settings import SettingsError

from .composition import composed
from .explained import complain

WRONG_ARGUMENTS = 2


def export(overrides: list[str], form: str, out: Path) -> int:
    """Write the data set that `overrides` name to the folder `out` and say how it is read back.

    Returns:
        The exit status: 0, or 2 where the overrides cannot be used.

    Raises:
        DatasetError: the data cannot be loaded, or the format cannot hold them.
        OSError: `out` cannot be written.
    """
    try:
        settings = composed(overrides)
    except SettingsError as error:
        complain("export", error)
        return WRONG_ARGUMENTS
    display = make_display(alone=True)
    display.start(settings.dataset_name)
    try:
        with listening(lambda stage, done, total: display.update({"stage": stage, "step": done, "steps": total})):
            scene = load_scene(settings.dataset, settings.cache_dir)
            written = export_scene(scene, out, form)
            again = load_scene(written, settings.cache_dir)
    finally:
        display.stop()
    print(f"{out}: {len(scene.train)} training and {len(scene.test)} test views, {len(scene.points):,} points")
    if not scene.placement.unmoved:
        print(f"its coordinates are the data's own; a run's world has them as {scene.placement}")
    print(f"cameras read back {_difference(scene, again)}")
    print(f"read it with: envgs-bench run {shlex.join(_as_overrides(written))}")
    return 0


def _difference(scene: Scene, again: Scene) -> str:
    """How far the cameras of two readings of a scene differ, in words; in the first one's world."""
    pairs = zip([*scene.train, *scene.test], [*again.train, *again.test], strict=True)
    moved = again.placement != scene.placement

    def in_our_world(camera: Camera) -> Camera:
        pose = scene.placement.pose_from_data(again.placement.pose_to_data(camera.world_to_camera.numpy()))
        return replace(camera, world_to_camera=torch.from_numpy(pose).float()) if moved else camera

    largest = max(_largest_difference(ours.camera, in_our_world(theirs.camera)) for ours, theirs in pairs)
    return "bit by bit" if largest == 0 else f"off by up to {largest:.1e}"


def _largest_difference(ours: Camera, theirs: Camera) -> float:
    poses = (ours.world_to_camera - theirs.world_to_camera).abs().max()
    return max(float(poses), float((ours.intrinsics - theirs.intrinsics).abs().max()))


def _as_overrides(settings: dict[str, Any]) -> list[str]:
    """`load_scene`'s settings as overrides of a run."""
    others = {key: _as_value(value) for key, value in settings.items() if key != "kind"}
    return [f"dataset={settings['kind']}", *(f"dataset.{key}={value}" for key, value in others.items())]


def _as_value(value: Any) -> str:
    """As an override's right side; text is quoted where its signs would mean something there."""
    if not isinstance(value, str):
        return json.dumps(value, separators=(",", ":"))
    try:
        plain = OverridesParser.create().parse_override(f"key={value}").value() == value
    except HydraException:
        plain = False
    return value if plain else "'" + value.replace("'", r"\'") + "'"
