"""GaussianMethod: what every method that rasterizes a trained base set shares; 2DGS and 3DGS are no more than this."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View, depth_normals, rasterize

from .checkpoint import read_checkpoint, write_checkpoint
from .densification import DensificationRule, screen_criterion
from .initialization import initial_tensors
from .losses import nearness, normal_distance, normal_loss, photometric_loss, psnr
from .method import Method
from .parameters import GaussianParameters, LearningRates
from .resident_views import ResidentViews
from .schedule import DENSIFY_FLOOR, Schedule
from .settings import GaussianSettings
from .trained_set import TrainedSet


class GaussianMethod(Method):
    """Trains a base set on whole images, one a step.

    Attributes:
        sets: the trained sets by name; always "base".
        near: hits nearer to the camera are not drawn, world units: the setting, or the scene's free space if larger.
        perceptual: the perceptual loss, (image, target) -> scalar, or None; the harness sets it.
    """

    Settings: ClassVar[type] = GaussianSettings
    settings: GaussianSettings
    axes: ClassVar[int]  # 2: surfels, 3: 3D Gaussians

    def __init__(self, settings: GaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        if settings.normal_weighting not in ("none", "depth"):
            raise ValueError(f"normal_weighting is {settings.normal_weighting!r}, expected none or depth")
        if settings.mono_loss not in ("cos", "l1_cos"):
            raise ValueError(f"mono_loss is {settings.mono_loss!r}, expected cos or l1_cos")
        self.sets: dict[str, TrainedSet] = {}
        self.perceptual: Callable[[Tensor, Tensor], Tensor] | None = None
        self.schedule = Schedule(1)
        self.radius = 1.0
        self.near = settings.near
        self.background = torch.zeros(3, device=self.device)
        self._prepared: dict[str, GaussianSet] = {}
        self._views = ResidentViews(self.device, room=0)

    def initialize(self, scene: Scene, steps: int) -> None:
        if not len(scene.points):
            raise ValueError(f"scene {scene.name} has no points to start from")
        self.schedule = Schedule(steps)
        self.radius = scene.radius or _extent(scene.points)
        self.near = max(self.settings.near, scene.free_space)
        self.background = scene.background.to(self.device)
        self.sets["base"] = self._new_set(
            scene.points, scene.point_colors, self._rule("base"), self._initial_beta(), generator=None
        )
        self._prepared.clear()
        self._views = ResidentViews.of(self.device)

    def training_step(self, view: View, step: int) -> dict[str, Tensor]:
        view = self._views.on_device(view)
        camera, target = view.camera, view.rgb(self.device)
        self._prepared.clear()
        self._set_rates(step)
        rendering, statistics = self._draw(camera, step)
        terms = self._losses(rendering, target, view, step)
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()

        finite = self._finite(loss.detach())  # on the device: a step never waits to learn whether it counts
        skipped = (~finite).float()
        for optimizer in self._optimizers():
            optimizer.found_inf = skipped  # type: ignore[attr-defined]  # torch's way to skip a fused step
            optimizer.step()
        for name, seen in statistics.items():
            learned = self._criterion(name, seen, camera), seen.weights
            self.sets[name].record.add(*(torch.where(finite, values, 0.0) for values in learned))
        self.skipped_steps = self.skipped_steps + skipped
        for optimizer in self._optimizers():
            optimizer.zero_grad(set_to_none=True)
        with torch.no_grad():
            self._after_step(step, self.events(step))
        shown = {"loss": loss, "psnr": psnr(rendering.color, target), **terms}
        return {name: value.detach() for name, value in shown.items()}

    def events(self, step: int) -> set[str]:
        """What this run does after Adam's step number `step`."""
        s, schedule, happens = self.settings, self.schedule, set()
        recovers = schedule.recovers(step, stop=s.densify_until, interval=s.opacity_reset_every)
        if not recovers and schedule.densifies(
            step, start=s.densify_from, stop=s.densify_until, every=self._densify_every(step)
        ):
            happens.add("densify_base")
        if schedule.resets(step, stop=s.densify_until, interval=s.opacity_reset_every):
            happens.add("reset_base_opacity")
        return happens

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        if not self._prepared:
            self.prepare()
        return self._draw(camera.to(self.device), None)[0]

    @torch.no_grad()
    def prepare(self) -> None:
        self._prepared = {name: trained.parameters.gaussians() for name, trained in self.sets.items()}

    def primitives(self) -> dict[str, int]:
        return {name: len(self.sets[name].parameters) if name in self.sets else 0 for name in ("base", "env")}

    def model_bytes(self) -> dict[str, int]:
        sets = self.sets
        return {name: sets[name].parameters.size_bytes if name in sets else 0 for name in ("base", "env")}

    def save(self, folder: Path) -> None:
        write_checkpoint(folder, type(self).__name__, self._state())

    def load(self, folder: Path) -> None:
        self._restore(read_checkpoint(folder, type(self).__name__, self.device))
        self._prepared.clear()

    # What a method may say otherwise

    def _draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        """The picture and, by set, what its passes learned; without gradients where `step` is None."""
        rendering = self._rasterize_base(camera, step)
        return rendering, {"base": rendering.statistics}

    def _losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """The weighted terms of the loss (Eq. 11)."""
        settings = self.settings
        terms = {"rgb": photometric_loss(rendering.color, target)}
        weight = self._normal_weights(rendering)
        if settings.normal_weight > 0 and step > self.schedule.at(settings.normal_from):
            reference = depth_normals(rendering.depth, view.camera, backend=settings.backend)
            terms["normal"] = settings.normal_weight * normal_loss(rendering.normal, reference, weight)
        if settings.mono_weight > 0 and view.normal is not None:
            mono_weight = settings.mono_weight * self.schedule.rate_scale
            error = normal_loss(rendering.normal, view.normal, weight)
            if settings.mono_loss == "l1_cos":
                error = error + normal_distance(rendering.normal, view.normal, weight)
            terms["mono"] = mono_weight * error
        if self.perceptual and settings.perceptual_weight > 0 and step > self.schedule.at(settings.perceptual_from):
            terms["perceptual"] = settings.perceptual_weight * self.perceptual(rendering.color, target)
        return terms

    def _densify_every(self, step: int) -> Fraction:
        """The base set's interval at this step, in steps of this run; 0: never."""
        return self.schedule.interval(self.settings.densify_every, DENSIFY_FLOOR)

    def _criterion(self, name: str, statistics: Statistics, camera: Camera) -> Tensor:
        return screen_criterion(statistics, camera)

    def _after_step(self, step: int, events: set[str]) -> None:
        """Densification and opacity resets, after Adam's step."""
        if "densify_base" in events:
            self.sets["base"].densify(self.radius, self.generator)
        if "reset_base_opacity" in events:
            self.sets["base"].reset_opacity()

    def _set_rates(self, step: int) -> None:
        s, schedule = self.settings, self.schedule
        position = schedule.rate(step, s.position_lr, s.position_lr_final) * schedule.rate_scale
        rotation = schedule.rate(step, s.rotation_lr, s.rotation_lr_final) * schedule.rate_scale
        for trained in self.sets.values():
            trained.parameters.set_learning_rate("means", position * self.radius)
            trained.parameters.set_learning_rate("quaternions", rotation)

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        return [trained.parameters.optimizer for trained in self.sets.values()]

    def _initial_beta(self) -> float | None:
        return None

    def _state(self) -> dict:
        sets = {name: trained.parameters.detached() for name, trained in self.sets.items()}
        return {"sets": sets, "radius": self.radius, "near": self.near, "background": self.background}

    def _restore(self, state: dict) -> None:
        self.radius, self.near, self.background = state["radius"], state["near"], state["background"]
        for name, tensors in state["sets"].items():
            parameters = GaussianParameters(tensors, self._rates(), self.radius)
            self.sets[name] = TrainedSet(parameters, self._rule(name))

    # Parts

    def _rasterize_base(self, camera: Camera, step: int | None) -> Rendering:
        return rasterize(
            self._gaussians("base", step),
            camera,
            background=self.background,
            near=self.near,
            backend=self.settings.backend,
        )

    def _gaussians(self, name: str, step: int | None) -> GaussianSet:
        """The set as it is drawn at a training step, or for an image where `step` is None."""
        if step is None:
            return self._prepared[name]
        every = self.schedule.at(self.settings.sh_every)
        degree = min(self.settings.sh_degree, step // every) if every else None
        return self.sets[name].parameters.gaussians(degree)

    def _normal_weights(self, rendering: Rendering) -> Tensor | None:
        return nearness(rendering.depth) if self.settings.normal_weighting == "depth" else None

    def _finite(self, loss: Tensor) -> Tensor:
        """Whether the loss and all gradients are finite, a tensor of no dimension: their largest magnitude tells."""
        gradients = [p.grad for o in self._optimizers() for g in o.param_groups for p in g["params"]]
        present = [gradient for gradient in gradients if gradient is not None and gradient.numel()]
        return torch.nn.utils.get_total_norm([loss, *present], math.inf).isfinite()

    def _new_set(
        self,
        points: Tensor,
        colors: Tensor,
        rule: DensificationRule,
        beta: float | None,
        generator: torch.Generator | None,
    ) -> TrainedSet:
        tensors = initial_tensors(
            points.to(self.device, torch.float32),
            colors.to(self.device, torch.float32),
            axes=self.axes,
            sh_degree=self.settings.sh_degree,
            opacity=self.settings.initial_opacity,
            beta=beta,
            radius=self.radius,
            generator=generator,
        )
        return TrainedSet(GaussianParameters(tensors, self._rates(), self.radius), rule)

    def _rule(self, name: str) -> DensificationRule:
        s = self.settings
        return DensificationRule(s.densify_threshold, s.min_opacity, s.max_primitives, s.min_coverage, s.min_views)

    def _rates(self) -> LearningRates:
        s, scale = self.settings, self.schedule.rate_scale
        return LearningRates(
            position=s.position_lr * scale,
            sh_dc=s.sh_lr * scale,
            sh_rest=s.sh_lr * scale / 20,
            opacity=s.opacity_lr,
            scale=s.scale_lr,
            rotation=s.rotation_lr * scale,
        )


def _extent(points: Tensor) -> float:
    """Half the diagonal of the points' box, at least a hair: the scene scale where all cameras share one center."""
    return max(0.5 * float((points.amax(0) - points.amin(0)).norm()), 1e-3)
