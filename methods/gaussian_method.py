"""GaussianMethod: how every method trains that rasterizes a base set; 2DGS and 3DGS are no more than this."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict, replace
from fractions import Fraction
from typing import Any, cast

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, Statistics, View
from envgs_bench.parts import ALPHA, BASE, BETA, MONO

from .gaussian_model import GaussianModel
from .gaussians.densification import DensificationRule, Oversized, screen_criterion
from .gaussians.frustum import in_view
from .gaussians.growth import BaseGrowth, max_base_primitives
from .gaussians.initialization import ORIENTATIONS, Orientation, half_diagonal
from .gaussians.pruning import prune
from .settings import GaussianSettings, check_words
from .storage.checkpoint import on_device
from .training.averaging import ParameterAverage
from .training.cuda_graphs import on_own_stream
from .training.exposure import AffineExposure
from .training.gradients import RememberedGradients, all_finite, largest_magnitudes
from .training.losses import training_psnr
from .training.optimizer import step_together
from .training.pilot_run import SHORTEST_RUN
from .training.resident_views import ResidentViews
from .training.schedule import DENSIFY_FLOOR, Schedule
from .training.seen_through_pilot import LearnedNormals, SeenThroughOutcome, seen_through_pilot
from .training.step_graphs import StepGraphs, StepNumbers
from .training.training_loss import TrainingLoss, lacking_normals

WORDS = {  # of settings that choose
    "normal_reference": ("unit", "alpha"),
    "normal_rendered": ("unit", "blended"),
    "exposure": ("none", "affine"),
    "normals": ("as_given", "agreed"),
    "mono_loss": ("cos", "l1_cos"),
    "mono_rendered": ("blended", "unit"),
    "normal_weighting": ("none", "depth", "alpha"),
    "perceptual_loss": ("features", "lpips"),
    "initial_orientation": ORIENTATIONS,
    "mean_gradient_over": ("drawn", "in_view"),
    "mean_gradient_of": ("all", "own"),
    "oversized": ("split", "prune"),
}


class GaussianMethod(GaussianModel):
    """Trains a base set on whole images, one a step. What a subclass may override or call is public:

    | when | what is called |
    |---|---|
    | a training step draws | before_step, set_learning_rates, draw, losses, phase |
    | and learns | optimizers, densification_criterion, contributions |
    | and changes the sets | events, after_step, densification_interval, densification_rule |
    | a training is interrupted and goes on | training_state, resume |

    and what a `GaussianModel` draws, holds and stores.

    Attributes:
        started_from: the scene that the sets start from.
    """

    started_from: Scene

    def __init__(self, settings: GaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        check_words(settings, WORDS)
        self._on_white = False
        self._normal_weight = 1.0
        self._maps: Mapping[str, Tensor] = {}
        self._gradients = RememberedGradients()
        self._average = ParameterAverage()
        self._views = ResidentViews(self.device, room=0)
        self._steps = StepGraphs(self._learn, self._learn_again)
        self._pilot: SeenThroughOutcome | None = None
        self._exposure: AffineExposure | None = None

    # From start to end

    def training_steps(self, steps: int) -> int:
        longest = self.settings.longest_run
        return min(steps, longest) if longest else steps

    def initialize(self, scene: Scene, steps: int) -> None:
        s = self.settings
        if not len(scene.points):
            raise ValueError(f"scene {scene.name} has no points to start from")
        if s.mono_weight > 0 and (lacking := lacking_normals(scene)):
            self.dropped_losses[MONO] = lacking
        self.schedule = Schedule(steps, s.stretches)
        self.radius = scene.radius or half_diagonal(scene.points)
        self.near = max(s.near, scene.free_space)
        learned = self._learned_normals(scene, steps)
        self.started_from, self.notes, self._normal_weight = scene, list(learned.notes), learned.weight
        self._start(scene)
        self._average = ParameterAverage()
        self._views = ResidentViews.of(self.device, learned)
        affine = s.exposure == "affine"
        self._exposure = AffineExposure([view.name for view in scene.train], self.device) if affine else None
        self._steps = StepGraphs(self._learn, self._learn_again)

    def _learned_normals(self, scene: Scene, steps: int) -> LearnedNormals:
        """None of what lies behind them: by a pilot run where there may be much and the run is long enough for one."""
        prior = scene.normals if self.uses_agreed_normals else None
        if prior is None:
            return LearnedNormals()
        if not prior.maybe_seen_through or steps < SHORTEST_RUN:
            return LearnedNormals.of(prior, len(scene.train))
        if self._pilot is None:
            settings = replace(self.settings, normals="as_given")  # the pilot run's views agree
            held, free = (self.for_trial(type(self), settings) for _ in range(2))
            self._pilot = seen_through_pilot(scene, prior, held, free)
        return LearnedNormals.by(prior, self._pilot)

    def for_trial(self, kind: type[GaussianMethod], settings: GaussianSettings) -> GaussianMethod:
        """A new method that a trial may train, with this one's device, seed and budget."""
        method = kind(settings, self.device, self.generator.initial_seed())
        if self._budget is not None:
            method.limit(self._budget.budget)
        return method

    def _start(self, scene: Scene) -> None:
        """Become a base set with a primitive at each of the scene's points."""
        self.background = scene.background.to(self.device)
        self._on_white = bool((scene.background == 1).all())
        self.max_base = max_base_primitives(self.settings, scene)
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
        self.forget_prepared()

    def training_state(self) -> dict[str, Any]:
        self.settle()
        skipped = self.skipped_steps
        return {
            "sets": {name: trained.training_state() for name, trained in self.sets.items()},
            "generator": self.generator.get_state(),
            "skipped_steps": skipped.clone() if isinstance(skipped, Tensor) else skipped,
            "gradients": self._gradients.training_state(),
            "average": self._average.state(),
            "budget": self._budget.training_state() if self._budget is not None else None,
            "exposure": self._exposure.training_state() if self._exposure is not None else None,
            "pilot": asdict(self._pilot) if self._pilot is not None else None,
        }

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self._pilot = SeenThroughOutcome(**state["pilot"]) if state["pilot"] is not None else None
        self.initialize(scene, steps)
        for name, trained in state["sets"].items():
            if name not in self.sets:  # made during the training: of any row, as all rows are replaced
                self.sets[name] = self.set_of(on_device(trained["parameters"]["tensors"], self.device))
            self.sets[name].restore_training(trained)
        self.generator.set_state(state["generator"])
        skipped = state["skipped_steps"]
        self.skipped_steps = skipped.to(self.device) if isinstance(skipped, Tensor) else skipped
        self._gradients.restore_training(state["gradients"])
        self._average.restore(state["average"], self.device)
        if self._exposure is not None:
            self._exposure.restore_training(state["exposure"])
        if self._budget is not None:
            self._budget.restore_training(state["budget"], self.device)

    # A training step

    def training_step(self, view: View, step: int) -> dict[str, Tensor]:
        # A perceptual loss is a large network's, which is worth all threads.
        threads = nullcontext() if self.uses_perceptual else self._suited_threads(view.camera)
        with on_own_stream(self.device), threads:
            return self._step(view, step)

    def _step(self, view: View, step: int) -> dict[str, Tensor]:
        view = self._views.on_device(view)
        self.forget_prepared()
        self.before_step(step)
        self.set_learning_rates(step)
        if self._captures() and self._exposure is None:  # a graph would hold one view's map
            holds = tuple(parameter for _, parameter in self._trained())
            numbers = self._steps.take(view, step, self.phase(step), holds)
        else:
            numbers = self._learn(view, step)
        self._gradients.add(*numbers.magnitudes())
        self._maps = numbers.maps
        if happens := self.events(step):
            self.settle()
        with torch.no_grad():
            self.after_step(step, happens)
        self._average_parameters(step, anew=bool(happens))
        return numbers.losses()

    def _average_parameters(self, step: int, anew: bool) -> None:
        """Late in a run, take the step into the average, which the last step ends with.

        Args:
            anew: whether something befell the sets: what they were before is another thing than what they become.
        """
        start, last = self.settings.average_from, step == self.schedule.steps
        if start == 0 or step <= self.schedule.at(start):
            return
        if anew:
            self._average = ParameterAverage()
        if last:
            self.settle()
        parameters = dict(self._trained())
        self._average.add(parameters)
        if last:
            self._average.move(parameters)
            self._average = ParameterAverage()  # whose memory whatever follows can use

    def _learn(self, view: View, step: int) -> StepNumbers:
        """All of a step that happens on the device. It never waits there, not even to learn whether the step counts."""
        camera, target = view.camera, view.rgb(self.device)
        rendering, statistics = self.draw(camera, step)
        color, held = self._photographed(rendering.color, view)
        terms = {**self.losses(replace(rendering, color=color), target, view, step), **held}
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()

        gradients = [(name, p.grad) for name, p in self._trained() if p.grad is not None and p.grad.numel()]
        magnitudes = largest_magnitudes([loss.detach(), *(gradient for _, gradient in gradients)])
        counts = all_finite(magnitudes)
        self._record(statistics, camera, counts)  # before Adam moves what was drawn
        self._measure(rendering, step, counts)
        self.skipped_steps += step_together(self.optimizers(), counts)
        if self._scales_are_bounded(step):
            self._bound_scales(camera, statistics[BASE].weights > 0)
        for optimizer in self.optimizers():
            optimizer.zero_grad(set_to_none=True)

        shown = {"loss": loss, "psnr": training_psnr(color, target), **terms}
        losses = torch.stack([value.detach() for value in shown.values()])
        values = torch.cat([losses, magnitudes[1:]])
        names = tuple(name for name, _ in gradients)
        return StepNumbers(tuple(shown), names, values, _maps_of(rendering))

    def _record(self, statistics: Mapping[str, Statistics], camera: Camera, counts: Tensor) -> None:
        """What densification will ask of the primitives that this step drew; nothing of a step that does not count."""
        for name, seen in statistics.items():
            learned = [self.densification_criterion(name, seen, camera), seen.weights]
            if name == BASE and self.settings.mean_gradient_over == "in_view":
                learned.append(self._in_view(camera))
            self.sets[name].record.add(*(torch.where(counts, values, 0.0) for values in learned))

    def _scales_are_bounded(self, step: int) -> bool:
        return self.settings.max_scale > 0 and self._growth().recovers(step)

    @torch.no_grad()
    def _bound_scales(self, camera: Camera, shown: Tensor) -> None:
        """While opacities recover from a reset, nothing that a view shows is larger than its distance allows.

        All are alike transparent then, and what covers a view from near by hides the others before they can tell what
        they are needed for: they get no gradient any more, and nothing takes its place.
        """
        tensors = self.sets[BASE].parameters.tensors
        distances = (tensors["means"] - camera.center).norm(dim=1)
        largest = torch.where(shown, self.settings.max_scale * distances, torch.inf).log()
        tensors["log_scales"].clamp_(max=largest[:, None])

    def _measure(self, rendering: Rendering, step: int, counts: Tensor) -> None:
        """What each set is worth to the picture, where a budget is shared by that."""
        if self._budget is not None:
            given = self.contributions(rendering, step)
            self._budget.measure({name: torch.where(counts, amount, 0.0) for name, amount in given.items()})

    def _photographed(self, color: Tensor, view: View) -> tuple[Tensor, dict[str, Tensor]]:
        """What was drawn [H, W, 3] as the view's camera shows it, and the loss of that by its name."""
        if self._exposure is None:
            return color, {}
        return self._exposure.applied(view.name, color), {"exposure": self._exposure.loss(view.name)}

    def _learn_again(self, view: View, step: int) -> StepNumbers:
        self.skipped_steps -= 1  # the first try
        return self._learn(view, step)

    def settle(self) -> None:
        self._steps.settle()

    def prepare(self) -> None:
        self._steps.release()
        super().prepare()

    # What happens in one

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

        Asked where a class is `captured`: what it draws and what it learns by must then depend on the step
        number through this alone, and neither may wait for the device.
        """
        degrees = (self.sh_degree(name, step) for name in self.sets)
        return *self._loss().began(step), self._scales_are_bounded(step), *degrees

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """The weighted terms of the loss (Eq. 11) by name, scalars; their sum is what is minimized.

        Args:
            rendering: what `draw` returned, with gradients.
            target: [H, W, 3] in [0, 1], the view's image on the method's device.
            view: the training view, camera and normals on the method's device.
        """
        perceptual = self.perceptual if self.uses_perceptual else None
        return self._loss().terms(rendering, target, view, step, self.mono_weights, perceptual)

    def mono_weights(self, rendering: Rendering) -> Tensor | None:
        """How much the view's own normals count at each pixel, [H, W] without gradients; None: alike everywhere."""
        return None

    @property
    def uses_agreed_normals(self) -> bool:
        return self.settings.normals == "agreed" and self.settings.mono_weight > 0

    @property
    def uses_perceptual(self) -> bool:
        return self.settings.perceptual_weight > 0

    @property
    def perceptual_loss(self) -> str:
        return self.settings.perceptual_loss

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """All optimizers: they step together, or none does where the loss or a gradient is not finite."""
        sets = [trained.parameters.optimizer for trained in self.sets.values()]
        return sets if self._exposure is None else [*sets, self._exposure.optimizer]

    def densification_criterion(self, name: str, statistics: Statistics, camera: Camera) -> Tensor:
        """The criterion [N] by which primitives of the set `name` are cloned or split, from one step's pass."""
        return screen_criterion(statistics, camera)

    def contributions(self, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """What each set gave to a training step's picture, scalars; empty where that says little as yet."""
        return {BASE: rendering.alpha.detach().sum()}

    # What happens after one

    def events(self, step: int) -> set[str]:
        """Names of what this run does after Adam's step number `step`; `after_step` does it."""
        return self._growth().events(step, self.densification_interval(step))

    def prunes(self, step: int) -> bool:
        return "prune" in self.events(step)

    def after_step(self, step: int, events: set[str]) -> None:
        """Do what `events` names, after Adam's step and without gradients: prunings, densification, opacity resets."""
        if "prune" in events:
            prune(self, self._training_views, self.settings.prune_error)
        if "densify_base" in events:
            self.densify(BASE, self._growth().oversized(step))
        if "reset_base_opacity" in events:
            self.sets[BASE].reset_opacity()

    def densify(self, name: str, oversized: Oversized = "split") -> None:
        """Grow and shrink the set `name` by its rule; where there is a budget, that is shared anew before."""
        if self._budget is not None:
            self._budget.decide()
        self.sets[name].densify(self.densification_rule(name), self.radius, self.generator, oversized)

    def densification_interval(self, step: int) -> Fraction:
        """Steps of this run between two densifications of the base set, as of `step`; 0: never."""
        return self.schedule.interval(self.settings.densify_every, DENSIFY_FLOOR)

    def densification_rule(self, name: str) -> DensificationRule:
        """When a primitive of the set `name` is cloned, split or removed."""
        s = self.settings
        return DensificationRule(
            s.densify_threshold, s.min_opacity, self.bound(name), s.min_coverage, s.min_views, s.max_growth
        )

    # What the harness looks at

    def last_maps(self) -> Mapping[str, Tensor]:
        return self._maps

    def needles(self) -> Mapping[str, Tensor]:
        return {name: trained.parameters.needles() for name, trained in self.sets.items() if len(trained.parameters)}

    def non_finite_gradients(self) -> list[str]:
        self.settle()
        return self._gradients.take_non_finite()

    def _loss(self) -> TrainingLoss:
        return TrainingLoss(self.settings, self.schedule, self._normal_weight)

    def _growth(self) -> BaseGrowth:
        return BaseGrowth(self.settings, self.schedule, self._on_white)

    def _training_views(self) -> Iterator[View]:
        return map(self._views.on_device, self.started_from.train)

    def _in_view(self, camera: Camera) -> Tensor:
        """Mask [N] of the base set's primitives that the camera has in view."""
        base = self.sets[BASE].parameters.tensors
        return in_view(base["means"], base["log_scales"].exp(), camera, self.near)

    def _trained(self) -> Iterator[tuple[str, Tensor]]:
        """All that the optimizers move, by name."""
        owners = {id(trained.parameters.optimizer): f"{name}." for name, trained in self.sets.items()}
        for optimizer in self.optimizers():
            for group in optimizer.param_groups:
                for parameter in group["params"]:
                    yield owners.get(id(optimizer), "") + group.get("name", "parameters"), parameter


def _maps_of(rendering: Rendering) -> dict[str, Tensor]:
    """What `last_maps` shows of a step: alpha, and the first extra channel where there is one."""
    maps = {ALPHA: rendering.alpha.detach()}
    if rendering.extras.shape[-1]:
        maps[BETA] = rendering.extras.detach()[..., 0]
    return maps
