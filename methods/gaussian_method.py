"""GaussianMethod: what every method that rasterizes a trained base set shares; 2DGS and 3DGS are no more than this."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable, Iterator, Mapping
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
from .captured_steps import CapturedSteps, StepNumbers
from .checkpoint import on_device, read_checkpoint, write_checkpoint
from .densification import DensificationRule, Oversized, screen_criterion
from .frustum import in_view
from .importance import removal_errors, without_least
from .initialization import ORIENTATIONS, Orientation, evenly_thinned, initial_orientation, initial_tensors
from .losses import nearness, normal_distance, normal_loss, photometric_loss, training_psnr
from .mending import Mended, mended
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
TRANSPARENT = -100.0  # logit of an opacity that draws nothing
REMEMBERED_STEPS = 32  # whose gradients' magnitudes are kept, to say which were not finite


class GaussianMethod(Method):
    """Trains a base set on whole images, one a step. What a subclass may override or call is public:

    | when | what is called |
    |---|---|
    | a training step draws | before_step, set_learning_rates, draw, losses, phase |
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
        started_from: the scene that the sets start from, its points mended where `mends_input` says so.
    """

    Settings: ClassVar[type] = GaussianSettings
    settings: GaussianSettings
    started_from: Scene
    axes: ClassVar[int]  # 2: surfels, 3: 3D Gaussians
    captured: ClassVar[bool] = False  # a GPU records its steps: all that the host decides in one is in `phase`

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
        self._maps: Mapping[str, Tensor] = {}
        self._norms: deque[tuple[list[str], Tensor]] = deque(maxlen=REMEMBERED_STEPS)
        self._views = ResidentViews(self.device, room=0)
        self._steps = CapturedSteps(self._learn, self._learn_again)

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
        found = Mended(scene)
        if self.settings.mends_input:
            found = mended(scene, self.near, self.settings.mono_weight > 0, self.generator, self.device)
        self.started_from = scene = found.scene
        self.mended = list(found.notes)
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
        self._views = ResidentViews.of(self.device, found.mirrored)
        self._steps = CapturedSteps(self._learn, self._learn_again)

    def training_step(self, view: View, step: int) -> dict[str, Tensor]:
        view = self._views.on_device(view)
        self.prepared.clear()
        self.before_step(step)
        self.set_learning_rates(step)
        if self._captures():
            holds = tuple(parameter for _, parameter in self._trained())
            numbers = self._steps.take(view, step, self.phase(step), holds)
        else:
            numbers = self._learn(view, step)
        self._norms.append(numbers.magnitudes())
        self._maps = numbers.maps
        if happens := self.events(step):
            self.settle()
        with torch.no_grad():
            self.after_step(step, happens)
        return numbers.losses()

    def _captures(self) -> bool:
        return self.captured and self.device.type == "cuda"

    def _learn(self, view: View, step: int) -> StepNumbers:
        """All of a step that happens on the device. It never waits there, not even to learn whether the step counts."""
        camera, target = view.camera, view.rgb(self.device)
        rendering, statistics = self.draw(camera, step)
        terms = self.losses(rendering, target, view, step)
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()

        names, gradients = self._gradients()
        magnitudes = _largest_magnitudes([loss.detach(), *gradients])
        finite = magnitudes.isfinite().all()
        for name, seen in statistics.items():  # before Adam moves what was drawn
            learned = [self.densification_criterion(name, seen, camera), seen.weights]
            if name == BASE and self.settings.mean_gradient_over == "in_view":
                learned.append(self._in_view(camera))
            self.sets[name].record.add(*(torch.where(finite, values, 0.0) for values in learned))
        skipped = (~finite).float()
        for optimizer in self.optimizers():
            optimizer.found_inf = skipped  # type: ignore[attr-defined]  # torch's way to skip a fused step
            optimizer.step()
        self.skipped_steps += skipped
        if self._budget is not None:
            given = self.contributions(rendering, step)
            self._budget.measure({name: torch.where(finite, amount, 0.0) for name, amount in given.items()})
        for optimizer in self.optimizers():
            optimizer.zero_grad(set_to_none=True)
        maps = {ALPHA: rendering.alpha.detach()}
        if rendering.extras.shape[-1]:
            maps[BETA] = rendering.extras.detach()[..., 0]
        shown = {"loss": loss, "psnr": training_psnr(rendering.color, target), **terms}
        losses = torch.stack([value.detach() for value in shown.values()])
        return StepNumbers(tuple(shown), tuple(names), torch.cat([losses, magnitudes[1:]]), maps)

    def _learn_again(self, view: View, step: int) -> StepNumbers:
        self.skipped_steps -= 1  # the first try
        return self._learn(view, step)

    def settle(self) -> None:
        self._steps.settle()

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
        self._steps.release()
        self.prepared = {name: trained.parameters.gaussians() for name, trained in self.sets.items()}

    def last_maps(self) -> Mapping[str, Tensor]:
        return self._maps

    def non_finite_gradients(self) -> list[str]:
        self.settle()
        found = [
            name
            for names, norms in self._norms
            for name, norm in zip(names, norms.tolist(), strict=True)
            if not math.isfinite(norm)
        ]
        self._norms.clear()
        return list(dict.fromkeys(found))

    def prunes(self, step: int) -> bool:
        return "prune" in self.events(step)

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
        self.settle()
        skipped = self.skipped_steps
        return {
            "sets": {name: trained.training_state() for name, trained in self.sets.items()},
            "generator": self.generator.get_state(),
            "skipped_steps": skipped.clone() if isinstance(skipped, Tensor) else skipped,
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

    def phase(self, step: int) -> Hashable:
        """What the host decides of a step: steps of equal phases launch the same kernels, whatever the numbers are.

        Asked where a class says that its steps may be `captured`: what it draws and what it learns by must then depend
        on the step number through this alone, and neither may wait for the device.
        """
        s, at = self.settings, self.schedule.at
        losses = (step > at(start) for start in (s.normal_from, s.mono_from, s.perceptual_from))
        return *losses, *(self._sh_degree(name, step) for name in self.sets)

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
        """Do what `events` names, after Adam's step and without gradients: prunings, densification, opacity resets."""
        if "prune" in events:
            self._prune()
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

    def _prune(self) -> None:
        """Remove what the training views miss least, of whichever set, as far as `prune_error` allows."""

        def draw(sets: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
            self.prepared = dict(sets)
            return self.draw(camera, None)[0]

        self.prepare()
        views = map(self._views.on_device, self.started_from.train)
        errors = removal_errors(self.prepared, draw, views, self.generator)
        most = (1 + self.settings.prune_error) * self._squared_error({})
        for name, rows in without_least(errors, most, self._squared_error).items():
            self.sets[name].keep(rows)

    def _squared_error(self, drawn: Mapping[str, Tensor]) -> float:
        """Σ over the training views' pixels and channels where of each set only the rows of a mask [N] are drawn."""
        logits = {name: self.sets[name].parameters.detached()["opacity_logits"] for name in drawn}
        before = {name: values.clone() for name, values in logits.items()}
        for name, values in logits.items():
            values.masked_fill_(~drawn[name], TRANSPARENT)
        self.prepare()
        error = torch.zeros((), device=self.device)
        for view in map(self._views.on_device, self.started_from.train):
            error += (self.draw(view.camera, None)[0].color - view.rgb(self.device)).square().sum()
        for name, values in before.items():
            logits[name].copy_(values)
        self.prepared.clear()
        return float(error)

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
        return self.sets[name].parameters.gaussians(self._sh_degree(name, step))

    def _sh_degree(self, name: str, step: int) -> int:
        """The SH degree that the color of the set `name` has at a training step."""
        every, since = self.schedule.at(self.settings.sh_every), step - self.schedule.at(self.sh_from(name))
        if since <= 0:
            return 0
        return min(self.settings.sh_degree, since // every) if every else self.settings.sh_degree

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

    def _gradients(self) -> tuple[list[str], list[Tensor]]:
        """The gradients of all that is trained, and the names of what they are of."""
        trained = [(name, p.grad) for name, p in self._trained() if p.grad is not None and p.grad.numel()]
        return [name for name, _ in trained], [gradient for _, gradient in trained]

    def _trained(self) -> Iterator[tuple[str, Tensor]]:
        """All that the optimizers move, by name."""
        owners = {id(trained.parameters.optimizer): f"{name}." for name, trained in self.sets.items()}
        for optimizer in self.optimizers():
            for group in optimizer.param_groups:
                for parameter in group["params"]:
                    yield owners.get(id(optimizer), "") + group.get("name", "parameters"), parameter


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
