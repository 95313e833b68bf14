"""Reflection: a base set whose pixels reflect, and where the reflected color comes from.

A rasterized base set gives each pixel's surface point, normal, base color and blending weight β; the reflected ray's
color is blended over the base (EnvGS paper, Sec. 4.1).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Camera, Rendering, Scene, Statistics, build_bvh, reflect, trace, trace_color
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, BETA, REFLECTION

from ..gaussians.initialization import evenly_thinned
from ..gaussians.model import GaussianModel
from ..gaussians.trained_set import TrainedSet
from ..training.schedule import Every, Part
from .settings import ReflectionSettings
from .supersampling import averaged, finer, repeated

FAINTEST, BRIGHTEST = 1e-4, 0.1  # transmittances at which a reflected ray ends, at the latest and at the earliest


class Light(Part):
    """Where reflected color comes from: a component of `Reflection`, whose other hooks are a `Part`'s."""

    def begin(self) -> None:
        """Come into being: called once, before the first step after the warm-up."""

    def color(
        self, origins: Tensor, directions: Tensor, step: int | None, beta: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        """The color that reflected rays see, and of a training step each traced set's statistics.

        Args:
            origins, directions: [H, W, 3] of `reflect`, world frame; the direction is 0 where nothing reflects.
            step: the training's; None for an image.
            beta: [H, W] how much of a pixel its ray makes; None: all of it.

        Returns:
            Color [H, W, 3], sRGB; differentiable in the rays where they carry gradients.
        """
        raise NotImplementedError


class Reflection(Part):
    """What a light shows along reflected rays, blended over the base set by β.

    Attributes:
        light: where the reflected color comes from.
        begun: whether anything reflects: true once the warm-up is over.
        rays_along: reflected rays leave along the mirror direction, or along the normal: what no view can turn.
        over: what is blended over the picture besides, of the picture, the camera and the step; None: nothing.
    """

    def __init__(self, model: GaussianModel, settings: ReflectionSettings, light: Light) -> None:
        self.light = light
        self.begun = False
        self.rays_along: Literal["mirrored", "normal"] = "mirrored"
        self.over: Callable[[Rendering, Camera, int | None], Rendering] | None = None
        self._model, self._settings = model, settings

    def blend(self, base: Rendering, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        """The picture with its reflection, and each traced set's statistics; the base as it is during the warm-up.

        Args:
            base: the base set alone, whose first extra channel is β.
            step: the training's; None for an image.
        """
        if not self.begun:
            return base, {}
        points = self._settings.supersampling
        if points == 1:
            origins, directions, beta = self.rays(base, camera, step)
            reflection, statistics = self.light.color(origins, directions, step, beta)
            beta = beta[..., None]
            blended = torch.lerp(base.color, reflection, beta)  # Eq. 5
        else:
            origins, directions, beta = self.rays(*finer(base, camera, points), step)
            reflection, statistics = self.light.color(origins, directions, step, beta)
            beta = beta[..., None]
            blended = averaged(torch.lerp(repeated(base.color, points), reflection, beta), points)
            for seen in statistics.values():
                seen.weights = seen.weights / points**2  # in pixels, as the base's
        layers = {BASE: base.color}
        if step is None:  # nobody looks at a training step's
            reflected = reflection * (beta > 0)
            layers[REFLECTION] = reflected if points == 1 else averaged(reflected, points)
        layers[BETA] = base.extras
        picture = replace(base, color=blended, layers=layers)
        return picture if self.over is None else self.over(picture, camera, step), statistics

    def rays(self, base: Rendering, camera: Camera, step: int | None) -> tuple[Tensor, Tensor, Tensor]:
        """Origins, directions and β of `reflect`: in training of every surface, in an image where it is visible."""
        s = self._settings
        if step is not None:
            base = self._taught(base)
        least = s.rule.reflect_alpha
        if least > 0 and (step is None or self._reflects_less(step)):
            base = replace(base, extras=base.extras * (base.alpha > least)[..., None])
        origins, directions, beta = reflect(
            base,
            camera,
            offset=s.rule.ray_offset * self._model.radius,
            beta_min=0.0 if step is not None else self._min_beta(base.extras),
            backend=s.backend,
        )
        if self.rays_along == "normal":
            directions = torch.where(directions.any(dim=-1, keepdim=True), unit(base.normal), 0.0)
        return origins, directions, beta

    @torch.no_grad()
    def seen(self, origins: Tensor, directions: Tensor) -> Tensor | None:
        """What rays [N, 3] of an image see, [N, 3] sRGB; None during the warm-up."""
        return self.light.color(origins[None], directions[None], None)[0][0] if self.begun else None

    def mono_weights(self, rendering: Rendering) -> Tensor | None:
        """1 where β is at least its start, in proportion to β below, and `mono_floor` at least; None: alike everywhere.

        On a mirror the depth map follows the reflected scene: only the view's own normals constrain the surface. On
        diffuse surfaces the depth map is more accurate than an estimate that is off by some degrees.
        """
        s = self._settings
        if s.rule.mono_floor == 1:
            return None
        return (rendering.extras.detach()[..., 0] / s.initial_beta).clamp(s.rule.mono_floor, 1)

    def _taught(self, base: Rendering) -> Rendering:
        """The base with normals and depths that pass gradients on only where reflected rays may move its surface.

        Where β is below its start, little reflects, and a reflection that explains little turns the surface at random.
        """
        s, detached = self._settings, replace(base, normal=base.normal.detach(), depth=base.depth.detach())
        if not s.joint:
            return detached
        reflects = base.extras[..., :1].detach() >= s.rule.joint_from * s.initial_beta
        normal = torch.where(reflects, base.normal, detached.normal)
        return replace(base, normal=normal, depth=torch.where(reflects[..., 0], base.depth, detached.depth))

    def _reflects_less(self, step: int) -> bool:
        return step > self._model.schedule.at(self._settings.rule.reflect_alpha_from)

    def _min_beta(self, beta: Tensor) -> Tensor | float:
        """The β [H, W, 1] of an image above which its rays are traced (paper, App. B.2)."""
        threshold, share = self._settings.rule.beta_threshold, self._settings.beta_filter
        if share == 0:
            return threshold
        rank = max(1, round(share * beta.numel()))
        # Sorted whole: on a GPU torch's kthvalue takes longer than the rays that are spared.
        return beta.flatten().sort().values[rank - 1].clamp_min(threshold)

    def start(self, scene: Scene) -> None:
        self.begun = False
        self.light.start(scene)

    def begin_step(self, step: int) -> None:
        if not self.begun and step > self._model.schedule.at(self._settings.warm_up):
            self.light.begin()
            self.begun = True
            if self._settings.rule.beta_starts_anew:
                self._model.sets[BASE].parameters.restart("beta_logits")
        self.light.begin_step(step)

    def phase(self, step: int) -> Hashable:
        return self.begun, self._reflects_less(step), self.light.phase(step)

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return self.light.optimizers()

    def events(self) -> Sequence[Every]:
        return self.light.events()

    def prepare(self) -> None:
        self.light.prepare()

    def model_bytes(self) -> dict[str, int]:
        return self.light.model_bytes()

    def most_bytes(self) -> int:
        return self.light.most_bytes()

    def training_state(self) -> dict[str, Any]:
        return {"begun": self.begun, "light": self.light.training_state()}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.begun = state["begun"]
        self.light.restore_training(state["light"])

    def state(self) -> dict[str, Any]:
        return {"reflects": self.begun, **self.light.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.begun = state["reflects"]
        self.light.restore(state)


class Origin:
    """What a traced set begins as."""

    def start(self, scene: Scene) -> None:
        """Look at the scene, before the first step."""

    def made(self, model: GaussianModel, name: str) -> TrainedSet:
        """The set `name`, after the warm-up."""
        raise NotImplementedError


class BaseCopy(Origin):
    """The base set as it is, without β: what surrounds a mirror is known by then (MaterialRefGS)."""

    def made(self, model: GaussianModel, name: str) -> TrainedSet:
        tensors = model.sets[BASE].parameters.detached()
        most, means = model.bound(name), tensors["means"]
        rows = evenly_thinned(means, most, model.generator) if 0 < most < len(means) else torch.arange(len(means))
        return model.set_of(
            name, {field: x[rows.to(x.device)] for field, x in tensors.items() if field != "beta_logits"}
        )


class Traced(Light):
    """Reflected color traced through one of the model's sets (paper, Sec. 4.2).

    Attributes:
        name: that set.
        behind: what rays see as far as the set lets them pass, a part of its own; None: the background.
    """

    def __init__(
        self,
        model: GaussianModel,
        settings: ReflectionSettings,
        name: str,
        origin: Origin | None = None,
    ) -> None:
        """
        Args:
            origin: what the set begins as; None of a set that is there.
        """
        self.name = name
        self.behind: Light | None = None
        self._model, self._settings, self._origin = model, settings, origin
        self._bvh: Bvh | None = None

    def start(self, scene: Scene) -> None:
        if self._origin is not None:
            self._origin.start(scene)

    def begin(self) -> None:
        if self._origin is not None:
            self._model.sets[self.name] = self._origin.made(self._model, self.name)
        if self.behind is not None:
            self.behind.begin()

    def prepare(self) -> None:
        gaussians = self._model.prepared.get(self.name)
        self._bvh = None if gaussians is None else build_bvh(gaussians, backend=self._settings.backend)

    def color(
        self, origins: Tensor, directions: Tensor, step: int | None, beta: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        """Without statistics of an image that nobody differentiates, and of the base set, which has its own."""
        arguments: dict[str, Any] = {
            "background": self._model.background if self._settings.rule.traced_background == "scene" else None,
            "t_min": self._settings.rule.traced_near,
            "transmittance_min": self._ends(beta),
            "sh_direction": self._settings.rule.traced_sh_direction,
            "bvh": self._bvh if step is None else None,
            "backend": self._settings.backend,
        }
        gaussians = self._model.gaussians(self.name, step)
        statistics: dict[str, Statistics] = {}
        if step is None and not torch.is_grad_enabled():
            color, alpha = trace_color(gaussians, origins, directions, **arguments)
        else:
            rendering = trace(gaussians, origins, directions, **arguments)
            color, alpha = rendering.color, rendering.alpha
            if self.name != BASE:
                statistics[self.name] = rendering.statistics
        if self.behind is not None:
            color = color + (1 - alpha)[..., None] * self.behind.color(origins, directions, step)[0]
        return color, statistics

    def _ends(self, beta: Tensor | None) -> Tensor | float:
        """The transmittance [H, W] at which rays end: what is behind would move the pixel by less than can be seen.

        Behind a hit that leaves transmittance T, a ray of weight β adds βT to its pixel at most. It is followed until
        that is below `beta_threshold`, and in any case until nine tenths of its light are known, lest β learn from a
        reflection that is too dark.
        """
        threshold = self._settings.rule.beta_threshold
        if beta is None or threshold == 0:
            return FAINTEST
        return threshold / beta.detach().clamp(threshold / BRIGHTEST, threshold / FAINTEST)
