"""A trained run as a workload: its own sets, the cameras of its scored views, its own rays, map and training views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from envgs_bench.core import GaussianSet, Scene, View, reflect
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.lighting.light_map import CubeMap, Filtered
from envgs_bench.methods.lighting.reflection import Traced
from envgs_bench.methods.lighting.settings import ReflectionSettings
from envgs_bench.methods.training.resident_views import ResidentViews
from envgs_bench.parts import BASE
from envgs_bench.settings import RunSettings
from envgs_bench.stages.evaluation import scored_views
from envgs_bench.stages.training_log import spread
from envgs_bench.stored.reopening import reopen, reopen_scene

from .cases import LOOKUPS, METHODS, OFFERED, WITHOUT_PICTURE, WITHOUT_SET, Case, directions_of
from .workload import Model, Workload

RAY_OFFSET = 1e-3  # where the method has none: a reflected ray starts this far above its surface, × scene radius


@dataclass(frozen=True)
class TimedRun:
    """A run that was opened once, to learn what can be timed on it."""

    folder: Path
    settings: RunSettings
    scene: Scene
    views: Sequence[View]  # whose cameras are timed
    training_views: Sequence[View]
    counts: dict[str, int]  # primitives that each operation works on; absent where the run has nothing for it

    @classmethod
    def opened(cls, folder: Path, views: int) -> TimedRun:
        """The run in `folder`, to be timed on so many views, spread evenly.

        Raises:
            ValueError, FileNotFoundError: as `reopen` and `reopen_scene`; or it draws without the core, or shows no
                view.
        """
        settings, method = reopen(folder, "cpu")
        if not isinstance(method, GaussianMethod):
            raise ValueError(f"{folder}: method {settings.method.name} trains no Gaussians that the core draws")
        scene = reopen_scene(folder, settings)
        scored = spread(scored_views(scene, settings.score_on), views)
        if not scored:
            raise ValueError(f"{folder}: its scene has no {settings.score_on} views whose cameras could be timed")
        return cls(folder, settings, scene, scored, spread(scene.train, views), _counts(method, settings.method_name))

    @property
    def name(self) -> str:
        """As rows have it: data set, method, and the folder of the run itself."""
        return f"{self.settings.dataset_name}/{self.settings.method_name}/{self.folder.resolve().name}"

    def cases(self, backends: Sequence[str], operations: Sequence[str] | None) -> list[Case]:
        """Every operation that the run has something for, or those of `operations`."""
        camera = self.views[0].camera
        found = []
        for backend in backends:
            offered = {*OFFERED[backend]} - {*METHODS}
            if backend in ("cpu", "cuda") and self.settings.method.settings.get("backend", "auto") in ("auto", backend):
                offered.add(self.settings.method_name)
            for op in (op for op in self.counts if op in offered and (not operations or op in operations)):
                plain = op in WITHOUT_PICTURE
                width, height = (None, None) if plain else (camera.width, camera.height)
                found += [
                    Case(op, way, backend, self.counts[op], width, height, self.name) for way in directions_of(op)
                ]
        return found


def _counts(method: GaussianMethod, name: str) -> dict[str, int]:
    base, everything = method.primitives()[BASE], sum(method.primitives().values())
    drawn = "rasterize_2d" if method.axes == 2 else "rasterize_3d"
    counts = {drawn: base, f"{drawn}_color": base}
    if method.axes == 2:
        counts |= dict.fromkeys(("trace", "trace_color", "build"), method.primitives()[_traced_set(method)])
    counts |= {"adam": everything, **dict.fromkeys(WITHOUT_SET, 0), name: everything}
    if map_of(method) is None:
        counts = {op: count for op, count in counts.items() if op not in LOOKUPS}
    return counts


def _traced_set(method: GaussianMethod) -> str:
    """The set that reflected rays are traced through; of methods that trace none, what they would meet: the base."""
    light = method.reflection.light if method.reflection is not None else None
    return light.name if isinstance(light, Traced) and light.name in method.model.sets else BASE


def map_of(method: GaussianMethod) -> CubeMap | None:
    """The cube map that the method learns; None of a method without."""
    lights: list[object] = [part.map if isinstance(part, Filtered) else part for part in method.parts.values()]
    if method.reflection is not None:
        lights.append(method.reflection.light)
    return next((light for light in lights if isinstance(light, CubeMap)), None)


class RunWorkload(Workload):
    """The run's model, opened anew, so that no case finds what another one has trained."""

    def __init__(self, run: TimedRun, device: torch.device) -> None:
        method = reopen(run.folder, device.type)[1]
        assert isinstance(method, GaussianMethod)
        self._run, self._method = run, method
        self.near = method.model.near
        self._resident = ResidentViews(device, room=0)
        self.views = list(map(self._resident.on_device, run.views))

    @torch.no_grad()
    def rasterized(self, view: View) -> GaussianSet:
        self._method.prepare()
        return self._method.model.base(view.camera, None)

    @torch.no_grad()
    def traced(self) -> GaussianSet:
        self._method.prepare()
        return self._method.model.prepared[_traced_set(self._method)]

    @torch.no_grad()
    def rays(self, view: View) -> tuple[Tensor, Tensor]:
        """Those of an image, where β is above the method's threshold; of a method without β, of every surface."""
        method = self._method
        method.prepare()
        base, offset, beta_min = method.model.rasterize(view.camera, None), RAY_OFFSET, 0.0
        if isinstance(method.settings, ReflectionSettings):
            offset, beta_min = method.settings.rule.ray_offset, method.settings.rule.beta_threshold
        else:
            base = replace(base, extras=torch.ones_like(base.alpha)[..., None])
        backend = method.settings.backend
        origins, directions, _ = reflect(
            base, view.camera, offset=offset * method.model.radius, beta_min=beta_min, backend=backend
        )
        return origins, directions

    def texels(self) -> Tensor:
        light = map_of(self._method)
        assert light is not None
        return light.texels.detach()

    def model(self) -> Model:
        method, steps = self._method, self._method.training_steps(self._run.settings.steps)
        state = method.state()
        method.initialize(self._run.scene, steps)
        method.restore(state)
        step = next(step for step in range(steps, 0, -1) if not method.runner.due(step))
        return Model(method, list(map(self._resident.on_device, self._run.training_views)), step)
