"""GaussianModel: the sets of Gaussians that a method trains, drawn, bounded and stored."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Statistics, rasterize, rasterize_color, torch_on_one_thread
from envgs_bench.parts import BASE, SETS

from .gaussians.budget import Budget, SharedBudget
from .gaussians.initialization import Orientation, evenly_thinned, initial_orientation, initial_tensors
from .gaussians.parameters import GaussianParameters, LearningRates, primitive_bytes
from .gaussians.trained_set import TrainedSet
from .method import Method
from .settings import GaussianSettings
from .storage.checkpoint import read_checkpoint, write_checkpoint
from .training.frame_graphs import Drawn, FrameGraphs, color_drawing, rendering_drawing
from .training.schedule import Schedule

SMALL_IMAGE = 1 << 17  # pixels, and
SMALL_SETS = 1 << 16  # primitives of all sets: a CPU takes longer to share an operation of torch's out than to do it
FULL = 0.95  # share of its cap from which a set is held back by it: some are pruned between two densifications


class GaussianModel(Method):
    """Trained sets of Gaussians, drawn by the core. What a subclass may override or call is public:

    | when | what is called |
    |---|---|
    | an image is drawn, or a training step draws | draw, rasterize_base, base_seen_from, gaussians, sh_from |
    | a budget or cap is kept | primitive_bytes, other_bytes, own_bound, cap |
    | a set is new or loaded | initial_learning_rates, initial_beta, initial_materials |
    | a checkpoint is written or read | state, restore |

    Attributes:
        sets: the trained sets by name; always BASE.
        near: hits nearer to the camera are not drawn, world units: the setting, or the scene's free space if larger.
        prepared: the sets as images draw them, activated, by name; empty until `prepare` and again after a step.
        schedule: the clock of this run, see `Schedule`.
        radius: the scene's, world units.
        background: [3] color behind everything, in [0, 1].
        max_base: the most primitives that the settings give the base set; 0: any number.
    """

    Settings: ClassVar[type] = GaussianSettings
    settings: GaussianSettings
    axes: ClassVar[int]  # 2: surfels, 3: 3D Gaussians
    captured: ClassVar[bool] = False  # a GPU records pictures and steps: what the host decides in one is in `phase`

    def __init__(self, settings: GaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.sets: dict[str, TrainedSet] = {}
        self.prepared: dict[str, GaussianSet] = {}
        self.schedule = Schedule(1)
        self.radius = 1.0
        self.near = settings.near
        self.background = torch.zeros(3, device=self.device)
        self.max_base = settings.max_primitives
        self._budget: SharedBudget | None = None
        self._frames = FrameGraphs(rendering_drawing(lambda camera: self.draw(camera, None)[0]), self.device)
        self._pictures = FrameGraphs(color_drawing(self._draw_color), self.device)

    # What is drawn

    def render(self, camera: Camera) -> Rendering:
        return self._shown(self._frames, camera)

    def picture(self, camera: Camera) -> Tensor:
        return self._shown(self._pictures, camera)

    @torch.no_grad()
    def _shown(self, frames: FrameGraphs[Drawn], camera: Camera) -> Drawn:
        """What `frames` draw of the camera, from a graph where that can be."""
        if not self.prepared:
            self.prepare()
        if self._captures():
            return frames.draw(camera)
        with self._suited_threads(camera):
            return frames.drawing.draw(camera.to(self.device))

    @torch.no_grad()
    def prepare(self) -> None:
        self.forget_prepared()
        self.prepared = {name: trained.parameters.gaussians() for name, trained in self.sets.items()}

    def forget_prepared(self) -> None:
        """What images are drawn from is no more what the sets are."""
        self.prepared.clear()
        self._frames.forget()
        self._pictures.forget()

    def _captures(self) -> bool:
        return self.captured and self.device.type == "cuda"

    def _suited_threads(self, camera: Camera) -> AbstractContextManager[None]:
        """On a CPU, torch's own operations take one thread where the image and the sets are small."""
        native = self.device.type == "cpu" and self.settings.backend in ("auto", "cpu")
        if native and camera.width * camera.height <= SMALL_IMAGE and sum(self.primitives().values()) <= SMALL_SETS:
            return torch_on_one_thread()
        return nullcontext()

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        """The picture [H, W, …], and the statistics of each set's passes: of a training step all of them.

        Args:
            camera: on the method's device.
            step: the training's; None for an image, which is drawn from `prepared` and without gradients.
        """
        rendering = self.rasterize_base(camera, step)
        return rendering, {BASE: rendering.statistics}

    def rasterize_base(self, camera: Camera, step: int | None) -> Rendering:
        """The base set alone, [H, W, …], with `draw`'s arguments."""
        counted = self.settings.mean_gradient_of == "all"
        seen = self.base_seen_from(camera, step)
        return rasterize(seen, camera, **self._rasterizing(), low_pass_statistics=counted)

    def _draw_color(self, camera: Camera) -> Tensor:
        """The color [H, W, 3] of `draw` for an image: drawn alone, unless a subclass has its own way to draw."""
        if type(self).draw is GaussianModel.draw and type(self).rasterize_base is GaussianModel.rasterize_base:
            return rasterize_color(self.base_seen_from(camera, None), camera, **self._rasterizing())[0]
        return self.draw(camera, None)[0].color

    def _rasterizing(self) -> dict[str, Any]:
        return {"background": self.background, "near": self.near, "backend": self.settings.backend}

    def base_seen_from(self, camera: Camera, step: int | None) -> GaussianSet:
        """The base set as it is drawn for this camera, with `draw`'s arguments: where a method shades primitives."""
        return self.gaussians(BASE, step)

    def gaussians(self, name: str, step: int | None) -> GaussianSet:
        """The set `name` as it is drawn at a training step, or for an image where `step` is None."""
        if step is None:
            return self.prepared[name]
        return self.sets[name].parameters.gaussians(self.sh_degree(name, step))

    def sh_degree(self, name: str, step: int) -> int:
        """The SH degree that the color of the set `name` has at a training step."""
        every, since = self.schedule.at(self.settings.sh_every), step - self.schedule.at(self.sh_from(name))
        if since <= 0:
            return 0
        return min(self.settings.sh_degree, since // every) if every else self.settings.sh_degree

    def sh_from(self, name: str) -> int:
        """The step of a run of 30,000 up to which the color of the set `name` is the same from everywhere."""
        return self.settings.sh_from

    # How large it is, and may be

    def primitives(self) -> dict[str, int]:
        return {name: len(self.sets[name].parameters) if name in self.sets else 0 for name in SETS}

    def model_bytes(self) -> dict[str, int]:
        sets = self.sets
        return {name: sets[name].parameters.size_bytes if name in sets else 0 for name in SETS}

    def limit(self, budget: Budget) -> None:
        self._budget = SharedBudget(budget, self.primitive_bytes(), self.other_bytes())

    def primitive_bytes(self) -> dict[str, int]:
        """The sets that the method trains, and the bytes of one primitive of each as float32."""
        return {BASE: primitive_bytes(self.axes, self.settings.sh_degree, self.initial_beta() is not None)}

    def other_bytes(self) -> int:
        """Bytes of all that the method trains besides primitives, as float32, the most of them at any step."""
        return 0

    def own_bound(self, name: str) -> int:
        """The most primitives that the settings give the set `name`; 0: any number."""
        return self.max_base

    def cap(self, name: str) -> int:
        """The most primitives of the set `name` that the settings name, whatever else bounds it; 0: any number."""
        return self.settings.max_primitives

    def capped(self) -> dict[str, int]:
        caps = {name: self.cap(name) for name in self.sets}
        return {name: cap for name, cap in caps.items() if 0 < FULL * cap <= len(self.sets[name].parameters)}

    def bound(self, name: str) -> int:
        """The most primitives that the set `name` may have now, by settings and budget; 0: any number."""
        own = {each: self.own_bound(each) for each in self.primitive_bytes()}
        return own[name] if self._budget is None else self._budget.bound(name, self.primitives(), own)

    # What a set starts from

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
        if self._budget is not None and len(points) > (most := self.bound(name)):
            rows = evenly_thinned(points, most, self.generator)
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
        return self.set_of(tensors | self.initial_materials(name, len(points)))

    def set_of(self, tensors: Mapping[str, Tensor]) -> TrainedSet:
        """A set of these fields, `GaussianParameters`' tensors, that nothing has been trained of."""
        return TrainedSet(GaussianParameters(tensors, self.initial_learning_rates(), self.radius))

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

    # What a checkpoint holds

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
        self.forget_prepared()

    def state(self) -> dict:
        """What `save` writes: tensors, numbers, strings, and dictionaries of them."""
        sets = {name: trained.parameters.detached() for name, trained in self.sets.items()}
        return {"sets": sets, "radius": self.radius, "near": self.near, "background": self.background}

    def restore(self, state: dict) -> None:
        """Become what `state` returned, tensors on the method's device. Raises ValueError where that cannot be."""
        self.radius, self.near, self.background = state["radius"], state["near"], state["background"]
        for name, tensors in state["sets"].items():
            self.sets[name] = self.set_of(tensors)
