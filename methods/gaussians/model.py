"""GaussianModel: the sets of Gaussians that a method trains: drawn, grown, bounded and stored."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, cast

import torch
from torch import Tensor

from envgs_bench.core import (
    Camera,
    GaussianSet,
    Rendering,
    Scene,
    Statistics,
    rasterize,
    rasterize_color,
    torch_on_one_thread,
)
from envgs_bench.parts import BASE, ENV, SETS

from ..settings import GaussianSettings
from ..training.schedule import Schedule
from .budget import SharedBudget
from .densification import screen_criterion
from .frustum import in_view
from .initialization import Orientation, evenly_thinned, half_diagonal, initial_orientation, initial_tensors
from .parameters import GaussianParameters
from .policy import SetPolicy
from .relocation import PositionNoise
from .trained_set import TrainedSet

NEAR = 0.2  # hits nearer to the camera are not drawn, world units; a scene's free space raises it
OPACITY_WEIGHT, SCALE_WEIGHT = 0.01, 0.01  # of what MCMC minimizes: mean opacity; mean scale ÷ scene radius
SMALL_IMAGE = 1 << 17  # pixels, and
SMALL_SETS = 1 << 16  # primitives of all sets: a CPU takes longer to share an operation of torch's out than to do it


class GaussianModel:
    """Sets of Gaussians, each trained by its policy.

    Attributes:
        axes: 2: surfels, 3: 3D Gaussians.
        sets: the trained sets by name; BASE once a training has started.
        policies: how each set is trained, of every set that there may be.
        prepared: the sets as images draw them, activated, by name; empty until `prepare` and again after a step.
        noise: what moves the base set's positions besides Adam; None: nothing.
        shade: what a camera sees of the base set at a step, or in an image (None); None: the set is drawn as it is.
        schedule: the clock of this run, see `Schedule`.
        radius: the scene's, world units.
        near: hits nearer to the camera are not drawn, world units: NEAR, or the scene's free space if larger.
        background: [3] color behind everything, in [0, 1].
        budget: what all sets share; None where there is none.
        left: the primitives that a pruning left of each set, which then grows no more; empty before the first one.
    """

    def __init__(self, settings: GaussianSettings, axes: int, device: torch.device, generator: torch.Generator) -> None:
        self.settings, self.axes, self.device, self.generator = settings, axes, device, generator
        self.sets: dict[str, TrainedSet] = {}
        self.policies: dict[str, SetPolicy] = {}
        self.prepared: dict[str, GaussianSet] = {}
        self.noise: PositionNoise | None = None
        self.shade: Callable[[GaussianSet, Camera, int | None], GaussianSet] | None = None
        self.schedule = Schedule(1)
        self.radius = 1.0
        self.near = NEAR
        self.background = torch.zeros(3, device=device)
        self.nothing = torch.zeros((), device=device)  # `torch.where` fills a new one for each number that it is given
        self.budget: SharedBudget | None = None
        self.left: dict[str, int] = {}

    # What is drawn

    @torch.no_grad()
    def prepare(self) -> None:
        self.prepared = {name: trained.parameters.gaussians() for name, trained in self.sets.items()}

    def gaussians(self, name: str, step: int | None) -> GaussianSet:
        """The set `name` as it is drawn at a training step, or for an image where `step` is None."""
        if step is None:
            return self.prepared[name]
        return self.sets[name].parameters.gaussians(self.policies[name].sh_degree_at(step))

    def base(self, camera: Camera, step: int | None) -> GaussianSet:
        """The base set as it is drawn for this camera: shaded, where the method shades primitives."""
        gaussians = self.gaussians(BASE, step)
        return gaussians if self.shade is None else self.shade(gaussians, camera, step)

    def rasterize(self, camera: Camera, step: int | None, gaussians: GaussianSet | None = None) -> Rendering:
        """The base set alone, or another one as it is, [H, W, …]."""
        return rasterize(
            self.base(camera, step) if gaussians is None else gaussians,
            camera,
            low_pass_statistics=self.settings.rule.mean_gradient_of == "all",
            color_statistics=self._grows_by_color(step),
            **self._rasterizing(),
        )

    def rasterize_color(self, camera: Camera) -> Tensor:
        """The color [H, W, 3] of `rasterize` for an image."""
        return rasterize_color(self.base(camera, None), camera, **self._rasterizing())[0]

    def suited_threads(self, camera: Camera) -> AbstractContextManager[None]:
        """On a CPU, torch's own operations take one thread where the image and the sets are small."""
        native = self.device.type == "cpu" and self.settings.backend in ("auto", "cpu")
        if native and camera.width * camera.height <= SMALL_IMAGE and sum(self.primitives().values()) <= SMALL_SETS:
            return torch_on_one_thread()
        return nullcontext()

    def _rasterizing(self) -> dict[str, Any]:
        return {"background": self.background, "near": self.near, "backend": self.settings.backend}

    # How large it is, and may be

    def size(self, name: str) -> int:
        """How many primitives the set `name` has; 0 of a missing one."""
        return len(self.sets[name].parameters) if name in self.sets else 0

    def primitives(self) -> dict[str, int]:
        return {name: self.size(name) for name in SETS}

    def model_bytes(self) -> dict[str, int]:
        return {name: self.sets[name].parameters.size_bytes if name in self.sets else 0 for name in SETS}

    def primitive_bytes(self) -> dict[str, int]:
        """The sets that are trained, and the bytes of one primitive of each as float32."""
        return {name: policy.primitive_bytes(self.axes) for name, policy in self.policies.items()}

    def bound(self, name: str) -> int:
        """The most primitives that the set `name` may have now, by settings, prunings and budget; 0: any number."""
        own = {each: policy.rule.max_primitives for each, policy in self.policies.items()}
        own |= {each: min(own[each] or left, left) for each, left in self.left.items()}
        return own[name] if self.budget is None else self.budget.bound(name, self.primitives(), own)

    # What sets start from, and become

    def start(self, scene: Scene, schedule: Schedule, policies: Mapping[str, SetPolicy]) -> None:
        """Become a base set with a primitive at each of the scene's points."""
        self.schedule = schedule
        self.near = max(NEAR, scene.free_space)
        self.radius = scene.radius or half_diagonal(scene.points)
        self.background = scene.background.to(self.device)
        self.policies = dict(policies)
        self.left = {}
        if self.budget is not None:
            self.budget.restart()
        self.sets.clear()
        self.sets[BASE] = self.new_set(BASE, scene.points, scene.point_colors)

    def new_set(self, name: str, points: Tensor, colors: Tensor) -> TrainedSet:
        """The set `name` with a primitive at each point, or at as many as a budget leaves; see `initial_tensors`.

        Args:
            points, colors: [N, 3] world frame, [N, 3] in [0, 1].
        """
        if self.budget is not None and len(points) > (most := self.bound(name)):
            rows = evenly_thinned(points, most, self.generator)
            points, colors = points[rows], colors[rows]
        points, start = points.to(self.device, torch.float32), self.policies[name].start
        tensors = initial_tensors(
            points,
            colors.to(self.device, torch.float32),
            initial_orientation(points, cast(Orientation, start.orientation), self.generator),
            axes=self.axes,
            sh_degree=self.policies[name].sh_degree,
            opacity=start.opacity,
            beta=start.beta,
            radius=self.radius,
            scale=start.scale,
        )
        own = start.materials(len(points))
        return self.set_of(name, tensors | {field: values.to(self.device) for field, values in own.items()})

    def set_of(self, name: str, tensors: Mapping[str, Tensor]) -> TrainedSet:
        """The set `name` of these fields, `GaussianParameters`' tensors, that nothing has been trained of."""
        return TrainedSet(GaussianParameters(tensors, self.policies[name].rates, self.radius))

    def densify(self, name: str, step: int) -> None:
        """Grow and shrink the set `name` by its policy; where there is a budget, that is shared anew before."""
        if self.budget is not None:
            self.budget.decide()
        policy = self.policies[name]
        if policy.fills_limit:
            self.sets[name].relocate(self.bound(name), self.generator, guided=policy.growth == "guided")
            return
        rule = policy.rule.of_at_most(self.bound(name))
        self.sets[name].densify(rule, self.radius, self.generator, policy.oversized_at(step))

    def reset_opacity(self, name: str, step: int) -> None:
        self.sets[name].reset_opacity()

    # A training step

    def set_learning_rates(self, step: int) -> None:
        """Give the optimizers this step's rates: positions' and rotations' decay log-linearly, others are constant."""
        for name, trained in self.sets.items():
            policy, parameters = self.policies[name], trained.parameters
            parameters.set_learning_rate("means", policy.position_rate(step, self.radius))
            parameters.set_learning_rate("quaternions", policy.rotation_rate(step))
            if trained.held_until is not None:
                held = step <= trained.held_until
                parameters.set_learning_rate("opacity_logits", 0.0 if held else policy.rates.opacity)
        if self.noise is not None:
            self.noise.draw(self.size(BASE), self.policies[BASE].position_rate(step, self.radius))

    def phase(self, step: int) -> Hashable:
        """What the host decides of a step."""
        young = tuple(policy.is_young(step) for policy in self.policies.values())
        degrees = (self.policies[name].sh_degree_at(step) for name in self.sets)
        return (self._grows_by_color(step), young, *degrees)

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return [trained.parameters.optimizer for trained in self.sets.values()]

    def named_parameters(self) -> Iterator[tuple[str, Tensor]]:
        """All fields of all sets, as <set>.<field>."""
        for name, trained in self.sets.items():
            for field, values in trained.parameters.tensors.items():
                yield f"{name}.{field}", values

    def losses(self) -> dict[str, Tensor]:
        """What a step minimizes of the sets themselves, weighted, by name: of growth that fills a size limit."""
        if not self.policies[BASE].fills_limit:
            return {}
        tensors = self.sets[BASE].parameters.tensors
        opacities, scales = tensors["opacity_logits"].sigmoid(), tensors["log_scales"].exp()
        return {  # means as sums, whose gradient is no tensor of its own
            "opacity": OPACITY_WEIGHT / opacities.numel() * opacities.sum(),
            "scale": SCALE_WEIGHT / self.radius / scales.numel() * scales.sum(),
        }

    def in_view(self, name: str, camera: Camera) -> Tensor:
        """[N] whether a camera has each primitive of a set in view, hidden or not."""
        tensors = self.sets[name].parameters.tensors
        return in_view(tensors["means"], tensors["quaternions"], tensors["log_scales"].exp(), camera, self.near)

    def mean_in_view(self, values: Tensor, camera: Camera) -> Tensor:
        """The mean of values [N] of the base set over what a camera has in view, scalar."""
        seen = self.in_view(BASE, camera)
        return (values * seen).sum() / seen.sum().clamp_min(1)

    def record(
        self, rendering: Rendering, statistics: Mapping[str, Statistics], camera: Camera, step: int, counts: Tensor
    ) -> None:
        """What densification and a shared budget will ask of a step; nothing of one that does not count.

        Args:
            rendering: the step's picture, and with it what each set's pass found of its primitives.
            counts: whether the step counts, a truth on the device.
        """
        for name, seen in statistics.items():
            means = self.sets[name].parameters.tensors["means"]
            learned = [self.policies[name].criterion(seen, camera, means), seen.weights]
            rasterized = self.policies[name].criterion is screen_criterion
            if rasterized and self.settings.rule.mean_gradient_over == "in_view":
                learned.append(self.in_view(name, camera))
            self.sets[name].record.add(*(torch.where(counts, values, self.nothing) for values in learned))
        if self.budget is not None:
            given = self.contributions(rendering, step)
            self.budget.measure({name: torch.where(counts, amount, 0.0) for name, amount in given.items()})

    def contributions(self, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """What each set gave to a training step's picture, scalars; empty where that says little as yet.

        Of two sets, how much the picture would change without either: to the base's color alone, or to the background.
        """
        if ENV not in self.policies:
            return {BASE: rendering.alpha.detach().sum()}
        if self.policies[ENV].is_young(step):
            return {}
        color = rendering.color.detach()
        without = {BASE: self.background, ENV: rendering.layers[BASE].detach()}
        return {name: (color - other).abs().sum() for name, other in without.items()}

    def drift(self, counts: Tensor) -> None:
        """Move the base set by its noise after Adam's step, if that counts, a truth on the device."""
        if self.noise is not None:
            self.noise.move(self.sets[BASE].parameters.tensors, counts)

    def _grows_by_color(self, step: int | None) -> bool:
        """Whether a step's gradients are held against a threshold, and are to be of the color alone."""
        if step is None or self.settings.rule.mean_gradient_of != "color":
            return False
        return step < self.schedule.at(self.policies[BASE].grows_until)

    # What is stored

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds: tensors, numbers, and dictionaries of them."""
        sets = {name: trained.parameters.detached() for name, trained in self.sets.items()}
        return {"sets": sets, "radius": self.radius, "near": self.near, "background": self.background}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become what `state` returned, tensors on the model's device."""
        self.radius, self.near, self.background = state["radius"], state["near"], state["background"]
        for name, tensors in state["sets"].items():
            self.sets[name] = self.set_of(name, tensors)

    def training_state(self) -> dict[str, Any]:
        return {
            "sets": {name: trained.training_state() for name, trained in self.sets.items()},
            "budget": self.budget.training_state() if self.budget is not None else None,
            "left": dict(self.left),
        }

    def restore_training(self, state: Mapping[str, Any]) -> None:
        """Become what `training_state` returned, tensors on the CPU, of a model that has started."""
        for name, trained in state["sets"].items():
            if name not in self.sets:  # made during the training: of any row, as all rows are replaced
                tensors = trained["parameters"]["tensors"]
                self.sets[name] = self.set_of(name, {field: x.to(self.device) for field, x in tensors.items()})
            self.sets[name].restore_training(trained)
        self.left = dict(state["left"])
        if self.budget is not None:
            self.budget.restore_training(state["budget"], self.device)
