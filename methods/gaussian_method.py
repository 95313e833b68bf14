"""GaussianMethod: what every method is that trains Gaussians: sets, a reflection over them, and other parts."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from contextlib import nullcontext
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, Statistics, View
from envgs_bench.parts import BASE, MONO

from .gaussians.budget import SharedBudget
from .gaussians.drawn_views import SAMPLED, DrawnViews
from .gaussians.model import NEAR, GaussianModel
from .gaussians.monitor import GaussianMonitor
from .gaussians.policy import INITIAL_OPACITY, SetPolicy, Start, base_policy, initial_rates
from .gaussians.pruning import Prunings, events_of, prune_to
from .gaussians.relocation import PositionNoise
from .lighting.reflection import Reflection
from .method import Budget, Method, Needs
from .settings import GaussianSettings
from .storage.checkpoint import read_checkpoint, write_checkpoint
from .training.cuda_graphs import on_own_stream
from .training.exposure import AffineExposure
from .training.frame_graphs import Pictures
from .training.losses import TrainingLoss, lacking_normals
from .training.resident_views import ResidentViews
from .training.schedule import Part, Schedule
from .training.seen_through_pilot import NORMALS, learned_normals
from .training.step_runner import StepRunner, Work, parameters_of


class GaussianMethod(Method):
    """Trains a base set on whole images, one a step, and whatever parts a subclass adds. What one may override:

    | what | where |
    |---|---|
    | how a set is trained, and which sets there are | policies |
    | what reflects, shades or is learned besides | `reflection` and `parts`, made in `__init__` |
    | a picture and its losses | draw, losses, and phase: what the host decides of a step |

    Attributes:
        cuda_graph: whether a GPU may take steps and pictures from CUDA graphs. Only what a class says itself counts,
            as a subclass may draw by what a graph does not know.
        model: the sets.
        reflection: what is blended over the base set by β; None of a method without, or with another way to draw.
        parts: what the method is made of besides the sets, by name; each is told of every step.
        runner: how steps are taken, and what they minimize.
        pictures: how images are drawn.
        found: what pilot runs have found, by name.
        drawn: pictures of the training views; None where no training has started.
    """

    Settings: ClassVar[type] = GaussianSettings
    settings: GaussianSettings
    axes: ClassVar[int]  # 2: surfels, 3: 3D Gaussians
    cuda_graph: ClassVar[bool] = False

    def __init__(self, settings: GaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.found: dict[str, dict[str, Any]] = {}
        self.drawn: DrawnViews | None = None
        self.model = GaussianModel(settings, self.axes, self.device, self.generator)
        self.model.policies = self.policies(self.model.schedule, None)
        self.reflection: Reflection | None = None
        self.parts: dict[str, Part] = {}
        loss = TrainingLoss(settings, self.model.schedule)
        work = Work(
            draw=lambda camera, step: self.draw(camera, step),
            losses=lambda *drawn: self.losses(*drawn),
            phase=lambda step: self.phase(step),
            optimizers=lambda: _optimizers(self),
            parameters=lambda: _parameters(self),
            record=self.model.record,
            drift=self.model.drift,
        )
        graphs = self.device.type == "cuda" and bool(vars(type(self)).get("cuda_graph"))
        self.runner = StepRunner(work, loss, self.device, type(self).__name__, graphs)
        self.pictures = Pictures(
            lambda camera: self.draw(camera, None)[0], lambda camera: _color(self, camera), self.device, graphs
        )

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        """How each set is trained in a run of that schedule; without a scene, of what no training has started."""
        s = self.settings
        start = Start(INITIAL_OPACITY, s.rule.initial_orientation)
        return {BASE: base_policy(s, schedule, scene, start=start, rates=initial_rates(s, schedule))}

    # What a picture is, and what a step minimizes

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        """The picture [H, W, …], and the statistics of each set's passes: of a training step all of them.

        Args:
            camera: on the method's device.
            step: the training's; None for an image, which is drawn from `prepared` sets and without gradients.
        """
        base = self.model.rasterize(camera, step)
        statistics = {BASE: base.statistics}
        if self.reflection is None:
            return base, statistics
        picture, of_rays = self.reflection.blend(base, camera, step)
        return picture, statistics | of_rays

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """The weighted terms of the loss (Eq. 11) by name, scalars; their sum is what is minimized.

        Args:
            rendering: what `draw` returned, with gradients.
            target: [H, W, 3] in [0, 1], the view's image on the method's device.
            view: the training view, camera and normals on the method's device.
        """
        trusted = None if self.reflection is None else self.reflection.mono_weights
        perceptual = self.perceptual.get(self.settings.rule.perceptual_loss)
        terms = self.runner.loss.terms(rendering, target, view, step, trusted, perceptual) | self.model.losses()
        for part in self.parts.values():
            terms |= part.losses(rendering, view, step)
        return terms

    def phase(self, step: int) -> Hashable:
        """What the host decides of a step: steps of equal phases launch the same kernels, whatever the numbers are.

        `draw` and `losses` may depend on the step's number through this alone, and none of them may wait for the
        device, where the class says `cuda_graph = True`.
        """
        parts = (part.phase(step) for part in self.parts.values())
        return *self.runner.loss.began(step), self.model.phase(step), *parts

    # From start to end

    @property
    def needs(self) -> Needs:
        s = self.settings
        return Needs(
            perceptual=s.rule.perceptual_loss if s.perceptual_weight > 0 else None,
            lpips=s.prune_error > 0,
            given=s.given,
            clearance=NEAR,
            agreed_normals=s.rule.normals == "agreed" and s.mono_weight > 0,
        )

    @property
    def skipped_steps(self) -> int | Tensor:  # type: ignore[override]  # the runner counts
        return self.runner.skipped

    def training_steps(self, steps: int) -> int:
        longest = self.settings.rule.longest_run
        return min(steps, longest) if longest else steps

    @torch.no_grad()
    def limit(self, budget: Budget) -> None:
        others = sum(part.most_bytes() for part in self.parts.values())
        shared, before = SharedBudget(budget, self.model.primitive_bytes(), others), self.model.budget
        self.model.budget = shared
        if self.drawn is None or budget.primitives is None:
            return
        if before is not None:
            shared.restore_training(before.training_state(), self.device)
        with on_own_stream(self.device):  # as what a training step does: later recordings know no other
            prune_to(self.drawn, budget.primitives)

    def initialize(self, scene: Scene, steps: int) -> None:
        s = self.settings
        if not len(scene.points):
            raise ValueError(f"scene {scene.name} has no points to start from")
        if s.mono_weight > 0 and (lacking := lacking_normals(scene)):
            self.dropped_losses[MONO] = lacking
        schedule = Schedule(steps, s.rule.stretches, s.rule.reference_steps)
        pilot = partial(fresh, self, s.ruled(normals="as_given"))  # whose views agree already
        learned = learned_normals(scene, steps, self.needs.agreed_normals, self.found, pilot)
        if not s.normals_of_glass and NORMALS not in self.found:
            learned = learned.outside_glass(scene)
        self.notes = list(learned.notes)
        self.runner.loss = TrainingLoss(s, schedule, learned.weight)
        self.model.start(scene, schedule, self.policies(schedule, scene))
        self.parts.pop("exposure", None)
        self.runner.exposure = None
        if s.exposure == "affine":
            self.runner.exposure = AffineExposure([view.name for view in scene.train], self.device)
            self.parts["exposure"] = self.runner.exposure
        if s.rule.growth == "mcmc":
            self.model.noise = PositionNoise(self.device, self.generator.initial_seed())
            self.parts["noise"] = self.model.noise
        for part in self.parts.values():
            part.start(scene)
        _forget_prepared(self)
        views = ResidentViews.of(self.device, learned)
        some = scene.train[:: -(-len(scene.train) // SAMPLED)]
        self.drawn = DrawnViews(self.model, self.draw, self.prepare, views.all_of(scene.train), views.all_of(some))
        prunings = None
        if s.prune_error > 0:
            lpips = self.perceptual.get("lpips")
            prunings = self.parts["prunings"] = Prunings(self.drawn, self.notes, self.runner.hear_of_noise, lpips)
        of_parts = [event for part in self.parts.values() for event in part.events()]
        self.runner.start(schedule, s.rule.average_from, views, events_of(self.model, prunings, of_parts))

    def training_step(self, view: View, step: int) -> dict[str, Tensor]:
        # A perceptual loss is a large network's, which is worth all threads.
        threads = nullcontext() if self.settings.perceptual_weight > 0 else self.model.suited_threads(view.camera)
        stream = on_own_stream(self.device) if self.device.type == "cuda" else nullcontext()
        with stream, threads:
            view = self.runner.views.on_device(view)
            if self.model.prepared:
                _forget_prepared(self)
            for part in self.parts.values():
                part.begin_step(step)
            self.model.set_learning_rates(step)
            return self.runner.take(view, step)

    def settle(self) -> None:
        self.runner.settle()

    @torch.no_grad()
    def prepare(self) -> None:
        self.runner.graphs.release()
        _forget_prepared(self)
        self.model.prepare()
        for part in self.parts.values():
            part.prepare()

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        if not self.model.prepared:
            self.prepare()
        with self.model.suited_threads(camera):
            return self.pictures.rendering(camera)

    @torch.no_grad()
    def picture(self, camera: Camera) -> Tensor:
        if not self.model.prepared:
            self.prepare()
        with self.model.suited_threads(camera):
            return self.pictures.color(camera)

    @property
    def monitor(self) -> GaussianMonitor:
        return GaussianMonitor(self.model, self.runner, self.reflection.seen if self.reflection else None)

    def primitives(self) -> dict[str, int]:
        return self.model.primitives()

    def model_bytes(self) -> dict[str, int]:
        sizes = self.model.model_bytes()
        for name, size in chain.from_iterable(part.model_bytes().items() for part in self.parts.values()):
            sizes[name] += size
        return sizes

    # What is stored

    def training_state(self) -> dict[str, Any]:
        return {
            "runner": self.runner.training_state(),  # first: it settles
            "model": self.model.training_state(),
            "generator": self.generator.get_state(),
            "parts": {name: part.training_state() for name, part in self.parts.items()},
            "found": self.found,
        }

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        self.found = state["found"]
        self.initialize(scene, steps)
        self.runner.restore_training(state["runner"])
        self.model.restore_training(state["model"])
        self.generator.set_state(state["generator"])
        for name, part in self.parts.items():
            part.restore_training(state["parts"][name])

    def save(self, folder: Path) -> None:
        write_checkpoint(folder, type(self).__name__, self.state())

    def load(self, folder: Path) -> None:
        state = read_checkpoint(folder, type(self).__name__, self.device)
        try:
            self.restore(state)
        except (AttributeError, KeyError, RuntimeError, TypeError) as error:
            lacks = f"{folder}: its checkpoint lacks what the method needs ({error!r}); train again"
            raise ValueError(lacks) from error
        _forget_prepared(self)

    def state(self) -> dict[str, Any]:
        """What `save` writes: tensors, numbers, strings, and dictionaries of them."""
        return dict(chain(self.model.state().items(), *(part.state().items() for part in self.parts.values())))

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become what `state` returned, tensors on the method's device. Raises ValueError where that cannot be."""
        self.model.restore(state)
        for part in self.parts.values():
            part.restore(state)


def fresh(method: GaussianMethod, settings: GaussianSettings) -> GaussianMethod:
    """A new method for a pilot run, with this one's class, device, seed and budget."""
    made = type(method)(settings, method.device, method.generator.initial_seed())
    if method.model.budget is not None:
        made.limit(method.model.budget.budget)
    return made


def _forget_prepared(method: GaussianMethod) -> None:
    """What images are drawn from is no more what the sets are."""
    method.model.prepared.clear()
    method.pictures.forget()


def _color(method: GaussianMethod, camera: Camera) -> Tensor:
    """The color [H, W, 3] of `draw` for an image: drawn alone where there is nothing but the base set."""
    if type(method).draw is GaussianMethod.draw and method.reflection is None:
        return method.model.rasterize_color(camera)
    return method.draw(camera, None)[0].color


def _optimizers(method: GaussianMethod) -> list[torch.optim.Optimizer]:
    """All of them: they step together, or none does where the loss or a gradient is not finite."""
    return [*method.model.optimizers(), *_of_parts(method)]


def _of_parts(method: GaussianMethod) -> Iterator[torch.optim.Optimizer]:
    return chain.from_iterable(part.optimizers() for part in method.parts.values())


def _parameters(method: GaussianMethod) -> Iterator[tuple[str, Tensor]]:
    """All that the optimizers move, by name."""
    return chain(method.model.named_parameters(), parameters_of(_of_parts(method)))
