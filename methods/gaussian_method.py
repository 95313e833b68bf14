"""GaussianMethod: what every method that rasterizes a trained base set shares; 2DGS and 3DGS are no more than this."""

from __future__ import annotations

import math
from collections import deque
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, cast

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View, depth_normals, rasterize
from envgs_bench.core.vectors import unit
from envgs_bench.parts import ALPHA, BASE, BETA, MONO, PERCEPTUAL, SETS

from .base_growth import BaseGrowth, max_base_primitives
from .budget import Budget, SharedBudget
from .checkpoint import on_device, read_checkpoint, write_checkpoint
from .densification import DensificationRule, Oversized, screen_criterion
from .frustum import in_view
from .initialization import ORIENTATIONS, Orientation, evenly_thinned, initial_orientation, initial_tensors
from .losses import nearness, normal_distance, normal_loss, photometric_loss, training_psnr
from .method import Method
from .parameters import GaussianParameters, LearningRates, primitive_bytes
from .resident_views import ResidentViews
from .schedule import DENSIFY_FLOOR, Schedule
from .settings import GaussianSettings, check_words
from .trained_set import TrainedSet

WORDS = {  # of settings that choose
    "normal_reference": ("unit", "alpha"),
    "normal_rendered": ("unit", "blended"),
    "mono_loss": ("cos", "l1_cos"),
    "mono_rendered": ("blended", "unit"),
    "normal_weighting": ("none", "depth", "alpha"),
    "perceptual_loss": ("features", "lpips"),
    "initial_orientation": ORIENTATIONS,
    "mean_gradient_over": ("drawn", "in_view"),
    "oversized": ("split", "prune"),
}
REMEMBERED_STEPS = 32  # whose gradients' magnitudes are kept, to say which were not finite


class GaussianMethod(Method):
    """Trains a base set on whole images, one a step. What a subclass may override or call is public:

    | when | what is called |
    |---|---|
    | a training step draws | before_step, set_learning_rates, draw, losses |
    | and learns | optimizers, densification_criterion, densification_interval, events, after_step |
    | an image | draw |
    | a budget is kept | primitive_bytes, other_bytes, own_bound, contributions |
    | a set is new or loaded | densification_rule, initial_learning_rates, initial_beta, initial_materials |
    | a checkpoint is written or read | state, restore |
    | a training is interrupted and goes on | training_state, resume |

    Attributes:
        sets: the trained sets by name; always BASE.
        near: hits nearer to the camera are not drawn, world units: the setting, or the scene's free space if larger.
        prepared: the sets as images draw them, activated, by name; empty until `prepare` and again after a step.
        schedule: the clock of this run, see `Schedule`.
        radius: the scene's, world units.
        background: [3] color behind everything, in [0, 1].
    """

    Settings: ClassVar[type] = GaussianSettings
    settings: GaussianSettings
    axes: ClassVar[int]  # 2: surfels, 3: 3D Gaussians

    def __init__(self, settings: GaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        check_words(settings, WORDS)
        self.sets: dict[str, TrainedSet] = {}
        self.schedule = Schedule(1)
        self.radius = 1.0
        self.near = settings.near
        self.background = torch.zeros(3, device=self.device)
        self._max_base = settings.max_primitives
        self._budget: SharedBudget | None = None
        self._on_white = False
        self.prepared: dict[str, GaussianSet] = {}
        self._maps: dict[str, Tensor] = {}
        self._norms: deque[tuple[list[str], Tensor]] = deque(maxlen=REMEMBERED_STEPS)
        self._views = ResidentViews(self.device, room=0)

    def limit(self, budget: Budget) -> None:
        self._budget = SharedBudget(budget, self.primitive_bytes(), self.other_bytes())

    def initialize(self, scene: Scene, steps: int) -> None:
        if not len(scene.points):
            raise ValueError(f"scene {scene.name} has no points to start from")
        if self.settings.mono_weight > 0 and (lacking := _without_normals(scene)):
            self.dropped_losses[MONO] = lacking
        self.schedule = Schedule(steps, self.settings.stretches)
        self.radius = scene.radius or _extent(scene.points)
        self.near = max(self.settings.near, scene.free_space)
        self.background = scene.background.to(self.device)
        self._on_white = bool((scene.background == 1).all())
        self._max_base = max_base_primitives(self.settings, scene)
        if self._budget is not None:
            self._budget.restart()
        self.sets.clear()
        self.sets[BASE] = self.new_set(
            BASE,
            scene.points,
            scene.point_colors,
            opacity=self.settings.initial_opacity,
            beta=self.initial_beta(),
            orientation=cast(Orientation, self.settings.initial_orientation),
        )
        self.prepared.clear()
        self._views = ResidentViews.of(self.device)

    def training_step(self, view: View, step: int) -> dict[str, Tensor]:
        view = self._views.on_device(view)
        camera, target = view.camera, view.rgb(self.device)
        self.prepared.clear()
        self.before_step(step)
        self.set_learning_rates(step)
        rendering, statistics = self.draw(camera, step)
        terms = self.losses(rendering, target, view, step)
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()

        finite = self._finite(loss.detach())  # on the device: a step never waits to learn whether it counts
        for name, seen in statistics.items():  # before Adam moves what was drawn
            learned = [self.densification_criterion(name, seen, camera), seen.weights]
            if name == BASE and self.settings.mean_gradient_over == "in_view":
                learned.append(self._in_view(camera))
            self.sets[name].record.add(*(torch.where(finite, values, 0.0) for values in learned))
        skipped = (~finite).float()
        for optimizer in self.optimizers():
            optimizer.found_inf = skipped  # type: ignore[attr-defined]  # torch's way to skip a fused step
            optimizer.step()
        self.skipped_steps = self.skipped_steps + skipped
        if self._budget is not None:
            given = self.contributions(rendering, step)
            self._budget.measure({name: torch.where(finite, amount, 0.0) for name, amount in given.items()})
        for optimizer in self.optimizers():
            optimizer.zero_grad(set_to_none=True)
        with torch.no_grad():
            self.after_step(step, self.events(step))
        self._maps = {ALPHA: rendering.alpha.detach()}
        if rendering.extras.shape[-1]:
            self._maps[BETA] = rendering.extras.detach()[..., 0]
        shown = {"loss": loss, "psnr": training_psnr(rendering.color, target), **terms}
        return {name: value.detach() for name, value in shown.items()}

    def training_steps(self, steps: int) -> int:
        longest = self.settings.longest_run
        return min(steps, longest) if longest else steps

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        if not self.prepared:
            self.prepare()
        return self.draw(camera.to(self.device), None)[0]

    @torch.no_grad()
    def prepare(self) -> None:
        self.prepared = {name: trained.parameters.gaussians() for name, trained in self.sets.items()}

    def last_maps(self) -> dict[str, Tensor]:
        return self._maps

    def non_finite_gradients(self) -> list[str]:
        found = [
            name
            for names, norms in self._norms
            for name, norm in zip(names, norms.tolist(), strict=True)
            if not math.isfinite(norm)
        ]
        self._norms.clear()
        return list(dict.fromkeys(found))

    def primitives(self) -> dict[str, int]:
        return {name: len(self.sets[name].parameters) if name in self.sets else 0 for name in SETS}

    def model_bytes(self) -> dict[str, int]:
        sets = self.sets
        return {name: sets[name].parameters.size_bytes if name in sets else 0 for name in SETS}

    def save(self, folder: Path) -> None:
        write_checkpoint(folder, type(self).__name__, self.state())

    def load(self, folder: Path) -> None:
        state = read_checkpoint(folder, type(self).__name__, self.device)
        try:
            self.restore(state)
        except (AttributeError, KeyError, RuntimeError, TypeError) as error:
            raise ValueError(
                f"{folder}: its checkpoint lacks what the method needs ({error!r}); train again"
            ) from error
        self.prepared.clear()

    def training_state(self) -> dict[str, Any]:
        return {
            "sets": {name: trained.training_state() for name, trained in self.sets.items()},
            "generator": self.generator.get_state(),
            "skipped_steps": self.skipped_steps,
            "norms": [[names, norms] for names, norms in self._norms],
            "budget": self._budget.training_state() if self._budget is not None else None,
        }

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self.initialize(scene, steps)
        for name, trained in state["sets"].items():
            if name not in self.sets:  # made during the training: of any row, as all rows are replaced
                tensors = on_device(trained["parameters"]["tensors"], self.device)
                parameters = GaussianParameters(tensors, self.initial_learning_rates(), self.radius)
                self.sets[name] = TrainedSet(parameters, self.densification_rule(name))
            self.sets[name].restore_training(trained)
        self.generator.set_state(state["generator"])
        skipped = state["skipped_steps"]
        self.skipped_steps = skipped.to(self.device) if isinstance(skipped, Tensor) else skipped
        self._norms.extend((names, norms) for names, norms in state["norms"])
        if self._budget is not None:
            self._budget.restore_training(state["budget"], self.device)

    @property
    def uses_perceptual(self) -> bool:
        return self.settings.perceptual_weight > 0

    @property
    def perceptual_loss(self) -> str:
        return self.settings.perceptual_loss

    # What happens in a training step

    def before_step(self, step: int) -> None:
        """Start what begins with this step, before anything is drawn: another phase, another resolution."""

    def set_learning_rates(self, step: int) -> None:
        """Give the optimizers this step's rates: positions' and rotations' decay log-linearly, others are constant."""
        s, schedule = self.settings, self.schedule
        rotation = schedule.rate(step, s.rotation_lr, s.rotation_lr_final) * schedule.rate_scale
        for name, trained in self.sets.items():
            trained.parameters.set_learning_rate("means", self.position_rate(name, step))
            trained.parameters.set_learning_rate("quaternions", rotation)

    def position_rate(self, name: str, step: int) -> float:
        """The learning rate of the positions of the set `name`, world units."""
        s, schedule = self.settings, self.schedule
        return schedule.rate(step, s.position_lr, s.position_lr_final) * schedule.rate_scale * self.radius

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        """The picture [H, W, …], and the statistics of each set's passes.

        Args:
            camera: on the method's device.
            step: the training's; None for an image, which is drawn from `prepared` and without gradients.
        """
        rendering = self.rasterize_base(camera, step)
        return rendering, {BASE: rendering.statistics}

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """The weighted terms of the loss (Eq. 11) by name, scalars; their sum is what is minimized.

        Args:
            rendering: what `draw` returned, with gradients.
            target: [H, W, 3] in [0, 1], the view's image on the method's device.
            view: the training view, camera and normals on the method's device.
        """
        settings = self.settings
        terms = {"rgb": photometric_loss(rendering.color, target, backend=settings.backend)}
        weight = self._normal_weights(rendering)
        if settings.normal_weight > 0 and step > self.schedule.at(settings.normal_from):
            reference = depth_normals(rendering.depth, view.camera, backend=settings.backend)
            if settings.normal_reference == "alpha":
                reference = reference * rendering.alpha.detach()[..., None]
            normal = unit(rendering.normal) if settings.normal_rendered == "unit" else rendering.normal
            terms["normal"] = settings.normal_weight * normal_loss(normal, reference, weight)
        mono = settings.mono_weight > 0 and step > self.schedule.at(settings.mono_from)
        if mono and view.normal is not None:
            mono_weight = settings.mono_weight * self.schedule.rate_scale
            trusted = self.mono_weights(rendering)
            if weight is not None:
                trusted = weight if trusted is None else trusted * weight
            normal = unit(rendering.normal) if settings.mono_rendered == "unit" else rendering.normal
            error = normal_loss(normal, view.normal, trusted)
            if settings.mono_loss == "l1_cos":
                error = error + normal_distance(normal, view.normal, trusted)
            terms[MONO] = mono_weight * error
        if self.perceptual and self.uses_perceptual and step > self.schedule.at(settings.perceptual_from):
            terms[PERCEPTUAL] = settings.perceptual_weight * self.perceptual(rendering.color, target)
        return terms

    def mono_weights(self, rendering: Rendering) -> Tensor | None:
        """How much the view's own normals count at each pixel, [H, W] without gradients; None: alike everywhere."""
        return None

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """All optimizers: they step together, or none does where the loss or a gradient is not finite."""
        return [trained.parameters.optimizer for trained in self.sets.values()]

    def densification_criterion(self, name: str, statistics: Statistics, camera: Camera) -> Tensor:
        """The criterion [N] by which primitives of the set `name` are cloned or split, from one step's pass."""
        return screen_criterion(statistics, camera)

    def _in_view(self, camera: Camera) -> Tensor:
        """Mask [N] of the base set's primitives that the camera has in view."""
        base = self.sets[BASE].parameters.tensors
        return in_view(base["means"], base["log_scales"].exp(), camera, self.near)

    def densification_interval(self, step: int) -> Fraction:
        """Steps of this run between two densifications of the base set, as of `step`; 0: never."""
        return self.schedule.interval(self.settings.densify_every, DENSIFY_FLOOR)

    def events(self, step: int) -> set[str]:
        """Names of what this run does after Adam's step number `step`; `after_step` does it."""
        return self._growth().events(step, self.densification_interval(step))

    def after_step(self, step: int, events: set[str]) -> None:
        """Do what `events` names, after Adam's step and without gradients: densification and opacity resets."""
        if "densify_base" in events:
            self.densify(BASE, self._growth().oversized(step))
        if "reset_base_opacity" in events:
            self.sets[BASE].reset_opacity()

    def densify(self, name: str, oversized: Oversized = "split") -> None:
        """Grow and shrink the set `name` by its rule; where there is a budget, that is shared anew before."""
        if self._budget is not None:
            self._budget.decide()
        self.sets[name].rule = self.densification_rule(name)
        self.sets[name].densify(self.radius, self.generator, oversized)

    # What a budget is kept by

    def primitive_bytes(self) -> dict[str, int]:
        """The sets that the method trains, and the bytes of one primitive of each as float32."""
        return {BASE: primitive_bytes(self.axes, self.settings.sh_degree, self.initial_beta() is not None)}

    def other_bytes(self) -> int:
        """Bytes of all that the method trains besides primitives, as float32, the most of them at any step."""
        return 0

    def own_bound(self, name: str) -> int:
        """The most primitives that the settings give the set `name`; 0: any number."""
        return self._max_base

    def contributions(self, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """What each set gave to a training step's picture, scalars; empty where that says little as yet."""
        return {BASE: rendering.alpha.detach().sum()}

    def bound(self, name: str) -> int:
        """The most primitives that the set `name` may have now, by settings and budget; 0: any number."""
        own = {each: self.own_bound(each) for each in self.primitive_bytes()}
        return own[name] if self._budget is None else self._budget.bound(name, self.primitives(), own)

    # What a set starts from, and what a checkpoint holds

    def densification_rule(self, name: str) -> DensificationRule:
        """When a primitive of the set `name` is cloned, split or removed."""
        s = self.settings
        return DensificationRule(
            s.densify_threshold, s.min_opacity, self.bound(name), s.min_coverage, s.min_views, s.max_growth
        )

    def initial_learning_rates(self) -> LearningRates:
        """Adam's step sizes of a new set."""
        s, scale = self.settings, self.schedule.rate_scale
        return LearningRates(
            position=s.position_lr * scale,
            sh_dc=s.sh_lr * scale,
            sh_rest=s.sh_lr * scale / 20,
            opacity=s.opacity_lr,
            scale=s.scale_lr,
            rotation=s.rotation_lr * scale,
        )

    def initial_beta(self) -> float | None:
        """The β in (0, 1) that base primitives start with; None for a base set without β."""
        return None

    def initial_materials(self, name: str, count: int) -> dict[str, Tensor]:
        """The fields [count, K] of a new set `name` that are this method's own; `initial_learning_rates` has theirs."""
        return {}

    def state(self) -> dict:
        """What `save` writes: tensors, numbers, strings, and dictionaries of them."""
        sets = {name: trained.parameters.detached() for name, trained in self.sets.items()}
        return {"sets": sets, "radius": self.radius, "near": self.near, "background": self.background}

    def restore(self, state: dict) -> None:
        """Become what `state` returned, tensors on the method's device. Raises ValueError where that cannot be."""
        self.radius, self.near, self.background = state["radius"], state["near"], state["background"]
        for name, tensors in state["sets"].items():
            parameters = GaussianParameters(tensors, self.initial_learning_rates(), self.radius)
            self.sets[name] = TrainedSet(parameters, self.densification_rule(name))

    # What a subclass draws and grows with

    def rasterize_base(self, camera: Camera, step: int | None) -> Rendering:
        """The base set alone, [H, W, …], with `draw`'s arguments."""
        return rasterize(
            self.base_seen_from(camera, step),
            camera,
            background=self.background,
            near=self.near,
            backend=self.settings.backend,
        )

    def base_seen_from(self, camera: Camera, step: int | None) -> GaussianSet:
        """The base set as it is drawn for this camera, with `draw`'s arguments: where a method shades primitives."""
        return self.gaussians(BASE, step)

    def gaussians(self, name: str, step: int | None) -> GaussianSet:
        """The set `name` as it is drawn at a training step, or for an image where `step` is None."""
        if step is None:
            return self.prepared[name]
        every, since = self.schedule.at(self.settings.sh_every), step - self.schedule.at(self.sh_from(name))
        if since <= 0:
            degree: int | None = 0
        else:
            degree = min(self.settings.sh_degree, since // every) if every else None
        return self.sets[name].parameters.gaussians(degree)

    def sh_from(self, name: str) -> int:
        """The step of a run of 30,000 up to which the color of the set `name` is the same from everywhere."""
        return self.settings.sh_from

    def new_set(
        self,
        name: str,
        points: Tensor,  # [N, 3]
        colors: Tensor,  # [N, 3] in [0, 1]
        opacity: float,
        beta: float | None,
        orientation: Orientation,
    ) -> TrainedSet:
        """The set `name` with a primitive at each point, or at as many as a budget leaves; see `initial_tensors`."""
        rule = self.densification_rule(name)
        if self._budget is not None and len(points) > rule.max_primitives:
            rows = evenly_thinned(points, rule.max_primitives, self.generator)
            points, colors = points[rows], colors[rows]
        points = points.to(self.device, torch.float32)
        tensors = initial_tensors(
            points,
            colors.to(self.device, torch.float32),
            initial_orientation(points, orientation, self.generator),
            axes=self.axes,
            sh_degree=self.settings.sh_degree,
            opacity=opacity,
            beta=beta,
            radius=self.radius,
        )
        tensors |= self.initial_materials(name, len(points))
        return TrainedSet(GaussianParameters(tensors, self.initial_learning_rates(), self.radius), rule)

    def _growth(self) -> BaseGrowth:
        return BaseGrowth(self.settings, self.schedule, self._on_white)

    def _normal_weights(self, rendering: Rendering) -> Tensor | None:
        match self.settings.normal_weighting:
            case "depth":
                return nearness(rendering.depth)
            case "alpha":
                return rendering.alpha.detach()
        return None

    def _finite(self, loss: Tensor) -> Tensor:
        """Whether the loss and all gradients are finite, a scalar tensor; judged by their largest magnitudes.

        These are remembered on the device: `non_finite_gradients` says which gradient it was.
        """
        names, gradients = [], []
        owners = {id(trained.parameters.optimizer): f"{name}." for name, trained in self.sets.items()}
        for optimizer in self.optimizers():
            for group in optimizer.param_groups:
                for parameter in group["params"]:
                    if parameter.grad is not None and parameter.grad.numel():
                        names.append(owners.get(id(optimizer), "") + group.get("name", "parameters"))
                        gradients.append(parameter.grad)
        norms = _largest_magnitudes([loss, *gradients])
        self._norms.append((names, norms[1:]))
        return norms.isfinite().all()


def _largest_magnitudes(tensors: list[Tensor]) -> Tensor:
    """Each tensor's, NaN where it holds one: on a GPU one kernel, which takes a CPU sixteen times as long."""
    if tensors[0].is_cuda:
        return torch.stack(torch._foreach_norm(tensors, math.inf))
    return torch.stack([tensor.abs().amax() for tensor in tensors])


def _without_normals(scene: Scene) -> str:
    """What L_mono lacks among the training views, in words; "" where all of them have normals."""
    count, those = len(scene.train), sum(view.normal is not None for view in scene.train)
    if those == count:
        return ""
    if not those:
        return "the data set has no normals for its training views"
    return f"only {those} of {count} training views have normals, and it counts at those alone"


def _extent(points: Tensor) -> float:
    """Half the diagonal of the points' box, at least 1e-3: the scene scale where all cameras share one center."""
    return max(0.5 * float((points.amax(0) - points.amin(0)).norm()), 1e-3)
