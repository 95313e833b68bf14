"""Loading: a run's scene as it is given to a method, and what cannot be trained on or scored."""

from __future__ import annotations

from envgs_bench.core import Scene
from envgs_bench.datasets.notes import collecting, note
from envgs_bench.datasets.progress import listening
from envgs_bench.metrics import MINIMUM_SIZE
from envgs_bench.records import RENDERS, WorldPlacement
from envgs_bench.settings import RunSettings

from .events import EventListener
from .perturbations import load_run_scene
from .results import Results

FEW_VIEWS = 12  # sparse-view methods are made for fewer


def load_for_run(settings: RunSettings, results: Results, report: EventListener) -> Scene:
    """The run's scene; making one for the first time may take minutes, and its source says how far it has come."""
    report({"stage": "loading"})
    tell = lambda stage, done, total: report({"stage": stage, "step": done, "steps": total})  # noqa: E731
    with listening(tell), collecting() as notes:
        scene = load_run_scene(settings)
        if len(scene.train) < FEW_VIEWS and settings.method.kind != RENDERS:
            note(f"data set {scene.name} has only {len(scene.train)} training views, of which little can be learned")
    results.dataset, results.notes = scene.name, notes
    results.attributes = dict(scene.attributes)
    results.placement = WorldPlacement(shift=scene.placement.shift, scale=scene.placement.scale)
    if notes:
        report({"stage": "loading", "notes": notes})
    return scene


def check_scene(scene: Scene) -> None:
    """Refuse, before anything is trained, what could not be trained on or not be scored at the end."""
    for name, views in (("training", scene.train), ("test", scene.test)):
        if not views:
            raise ValueError(f"data set {scene.name} has no {name} views: it needs at least two images")
    for view in (*scene.test, *scene.val):
        width, height = view.camera.width, view.camera.height
        if min(width, height) < MINIMUM_SIZE:
            raise ValueError(
                f"data set {scene.name}: view {view.name} is {width}×{height} pixels, expected at least "
                f"{MINIMUM_SIZE}×{MINIMUM_SIZE}, since metrics need them; take larger pictures, or a smaller "
                "dataset.downsample"
            )
