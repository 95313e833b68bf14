"""Planes: flat mirrors and panes that reflect the base set, traced along rays mirrored at them (after TR-Gaussians).

What shows in a flat mirror stands still behind it, so a base set models it as a room there, blurred and a second time.
A plane shows the room itself instead: (1 − R)·C_t + R·C_r, with C_t what is drawn behind the plane, C_r what the
mirrored ray sees, and R = R₀ + (1 − R₀)(1 − cos θ)⁵ (Schlick), where nothing stands before the plane.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Camera, GaussianSet, Rendering, Scene, View, build_bvh, trace
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, ENV

from ..gaussians.model import GaussianModel
from ..gaussians.trained_set import RESET_OPACITY
from ..training.schedule import RESET_FLOOR, Every, Part
from ..training.weights import Weights
from .plane_alignment import Aligned, aligned
from .plane_proposals import MOST, Rectangle, inside_of, proposed, turned
from .settings import EnvGSSettings

BOUNCES = 3  # between planes
EDGE = 0.004  # width of a plane's edge, × scene radius
MARGIN = 0.01  # × scene radius: what is nearer to a plane belongs to it, and mirrored rays do not see it
REACH = 3.0  # standard deviations that a surfel reaches
DETACHED = 3_000  # steps of a run of 30,000 after the warm-up in which what planes show teaches the base nothing
PANE = 0.1  # R₀ that planes begin with that are no mirrors
CLEARED_EVERY, MIRROR = 1_500, 0.45  # steps between clearings behind what reflects as much
RATES = {"plane_centers": 2e-4, "plane_turns": 1e-4, "plane_halves": 1e-3, "plane_reflectances": 1e-2}


class Planes(Part):
    """The planes of one scene.

    Attributes:
        begun: whether they reflect, which they do once the base set's warm-up is over.
        settled: whether they were aligned for the last time.
        frames: [P, 3, 3] their axes as proposed: along, across, normal; rows.
        weights: centers [P, 3] in scene radii, rotation vectors [P, 3], logarithms of half their sizes [P, 2], and
            logits of R₀ [P, 3].
    """

    def __init__(self, model: GaussianModel, settings: EnvGSSettings) -> None:
        self.begun = self.settled = False
        self._model, self._settings = model, settings
        self._views: list[View] = []
        self._bvh: Bvh | None = None
        self._become([])

    def _become(self, rectangles: Sequence[Rectangle], reflectances: Sequence[float] = ()) -> None:
        count, device = len(rectangles), self._model.device
        shapes = {"plane_centers": (count, 3), "plane_turns": (count, 3), "plane_halves": (count, 2)}
        self.weights = Weights(shapes | {"plane_reflectances": (count, 3)}, RATES, device)
        self.frames = torch.zeros(0, 3, 3, device=device)
        if not count:
            return
        self.frames = torch.stack([each.axes.detach() for each in rectangles]).to(device)
        starts = torch.tensor([*reflectances] or [PANE] * count).logit()
        values = {
            "plane_centers": torch.stack([each.center for each in rectangles]) / self._model.radius,
            "plane_turns": torch.zeros(count, 3),
            "plane_halves": torch.stack([each.half for each in rectangles]).log(),
            "plane_reflectances": starts[:, None].repeat(1, 3),
        }
        self.weights.become(values)

    def start(self, scene: Scene) -> None:
        self.begun = self.settled = False
        self._views = list(scene.train)
        self._become(proposed(scene, self._settings.planes))

    @torch.no_grad()
    def begin_step(self, step: int) -> None:
        """The planes begin after the warm-up, and are aligned again with what the base set has become by then."""
        if not len(self.frames) or step <= self._model.schedule.at(self._settings.warm_up):
            return
        if not self.begun:
            self._align(step, 0.005 if self._settings.planes == "masks" else 0.04)
            self.begun = True
        elif not self.settled and not self._detaches(step):
            self._align(step, 0.005)
            self.settled = True

    def _align(self, step: int, furthest: float) -> None:
        strengths = self.weights.tensors["plane_reflectances"].sigmoid().mean(1).tolist()
        planes = [Aligned(*each) for each in zip(self.rectangles(), strengths, strict=True)]
        found = aligned(self._model.gaussians(BASE, step), planes, self._views, self._model, furthest)
        if self.begun and self._settings.planes == "photographs":  # nobody has said that there is glass
            found = [each for each in found if each.reflectance > MIRROR]
        self._become([each.rectangle for each in found], [each.reflectance for each in found])
        self.clear(step)

    def phase(self, step: int) -> Hashable:
        return self.begun, self.settled, self._detaches(step)

    def _detaches(self, step: int) -> bool:
        at = self._model.schedule.at
        return step <= at(self._settings.warm_up + DETACHED)

    def rectangles(self) -> list[Rectangle]:
        """The planes as they are; differentiable."""
        w = self.weights.tensors
        axes = turned(self.frames, w["plane_turns"])
        centers, halves = w["plane_centers"] * self._model.radius, w["plane_halves"].exp()
        return [Rectangle(*each) for each in zip(centers, axes, halves, strict=True)]

    # What they show

    def over(self, picture: Rendering, camera: Camera, step: int | None) -> Rendering:
        """The picture with what its planes reflect; as it is where there are none, and before they begin.

        Args:
            picture: of the base set, and whatever else is blended over it.
            step: the training's; None for an image.
        """
        if not (self.begun and len(self.frames)):
            return picture
        base, planes = self._model.gaussians(BASE, step), self.rectangles()
        reach = REACH * base.scales.detach().amax(1)
        hides = ~behind(base.means.detach(), camera.center, planes, MARGIN * self._model.radius, reach)
        front = self._model.rasterize(camera, step, replace(base, opacities=base.opacities * hides))
        origins, rays = camera.rays()
        weight, points, mirrored = self._met(planes, origins, unit(rays))
        bvh = self._bvh if step is None else build_bvh(base, backend=self._settings.backend)
        reflected = self._seen(base, bvh, planes, points, mirrored, BOUNCES)
        if step is not None and self._detaches(step):
            reflected = reflected.detach()
        hidden = 1 - front.alpha[..., None]
        shown = front.color + hidden * (reflected - self._model.background)
        return replace(picture, color=torch.lerp(picture.color, shown, weight))

    def _met(
        self, planes: Sequence[Rectangle], origins: Tensor, directions: Tensor, depth: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """R [..., 3] where rays meet their nearest plane, before `depth` if that is given; there, and mirrored there.

        A direction is 0 where no plane is met.
        """
        radius = self._model.radius
        found = [inside_of(plane, origins, directions, EDGE * radius) for plane in planes]
        within = torch.stack([each for each, _ in found])
        distance = torch.stack([each for _, each in found])
        met = (within > 0) & (distance > MARGIN * radius)
        if depth is not None:
            met = met & (depth > distance - MARGIN * radius)
        distance, index = torch.where(met, distance, torch.inf).min(0)
        # By products: of an index, the gradient would be added up pixel after pixel.
        own = (index[..., None] == torch.arange(len(planes), device=index.device)).to(directions)
        normals = own @ torch.stack([plane.axes[2] for plane in planes])
        share = within.gather(0, index[None])[0] * distance.isfinite()
        distance = torch.where(distance.isfinite(), distance, 0.0)
        cosine = (directions * normals).sum(-1, keepdim=True)
        straight = own @ self.weights.tensors["plane_reflectances"].sigmoid()
        weight = share[..., None] * (straight + (1 - straight) * (1 - cosine.abs()).clamp_min(0) ** 5)
        mirrored = (directions - 2 * cosine * normals) * (share > 0)[..., None]
        return weight, origins + distance[..., None] * directions, mirrored

    def _seen(
        self,
        base: GaussianSet,
        bvh: Bvh | None,
        planes: Sequence[Rectangle],
        points: Tensor,
        rays: Tensor,
        bounces: int,
    ) -> Tensor:
        """What mirrored rays [H, W, 3] see, at further planes too."""
        drawn = trace(
            base,
            points,
            rays,
            background=self._model.background,
            t_min=MARGIN * self._model.radius,
            bvh=bvh,
            backend=self._settings.backend,
        )
        if bounces == 1:
            return drawn.color
        depth = torch.where(drawn.alpha > 0.5, drawn.depth, torch.inf).detach()
        weight, points, mirrored = self._met(planes, points, rays, depth)
        return torch.lerp(drawn.color, self._seen(base, bvh, planes, points, mirrored, bounces - 1), weight)

    # What befalls the base set

    def events(self) -> Sequence[Every]:
        if not len(self.frames):
            return []
        every = self._model.schedule.interval(CLEARED_EVERY, RESET_FLOOR)
        span = self._model.schedule.at(self._settings.warm_up), self._model.schedule.at(self._settings.densify_until)
        return [Every("clear", self.clear, lambda step: every, *span, recovery=RESET_FLOOR)]

    @torch.no_grad()
    def clear(self, step: int) -> None:
        """Let what lies behind mirrors be transparent, so that it comes back only where the planes leave something."""
        strengths = self.weights.tensors["plane_reflectances"].sigmoid().mean(1).tolist()
        mirrors = [plane for plane, strength in zip(self.rectangles(), strengths, strict=True) if strength > MIRROR]
        if not mirrors:
            return
        parameters = self._model.sets[BASE].parameters
        means, logits = parameters.tensors["means"].detach(), parameters.tensors["opacity_logits"].detach()
        hidden = torch.zeros(len(means), device=means.device)
        for view in self._views:
            hidden += behind(means, view.camera.to(means.device).center, mirrors, 0.0)
        cleared = logits.clamp_max(math.log(RESET_OPACITY / (1 - RESET_OPACITY)))
        parameters.replace("opacity_logits", torch.where(hidden > len(self._views) / 2, cleared, logits))

    def prepare(self) -> None:
        self._bvh = build_bvh(self._model.prepared[BASE], backend=self._settings.backend) if self.begun else None

    # What is stored

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return self.weights.optimizers() if self.begun and len(self.frames) else ()

    def model_bytes(self) -> dict[str, int]:
        return {ENV: self.weights.most_bytes()}

    def most_bytes(self) -> int:
        return 4 * 11 * MOST

    def training_state(self) -> dict[str, Any]:
        return {
            "begun": self.begun,
            "settled": self.settled,
            "frames": self.frames,
            "weights": self.weights.training_state(),
        }

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self._of_frames(state["frames"])
        self.weights.restore_training(state["weights"])
        self.begun, self.settled = state["begun"], state["settled"]

    def state(self) -> dict[str, Any]:
        return {"planes": self.begun, "plane_frames": self.frames} | self.weights.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self._of_frames(state["plane_frames"])
        self.weights.restore(state)
        self.begun = state["planes"]

    def _of_frames(self, frames: Tensor) -> None:
        ones = torch.ones(3)
        self._become([Rectangle(ones, axes, ones[:2]) for axes in frames.to(self._model.device)])


@torch.no_grad()
def behind(
    points: Tensor, center: Tensor, planes: Sequence[Rectangle], margin: float, reach: Tensor | float = 0.0
) -> Tensor:
    """Which points [N, 3] a camera at `center` [3] sees through a plane, or within `margin` before it; [N].

    Args:
        reach: [N] how far beside a plane a point may be seen too, as what lies there reaches so far.
    """
    found = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    away = points - center
    for plane in planes:
        height, rise = (plane.center - center) @ plane.axes[2], away @ plane.axes[2]
        share = height / torch.where(rise.abs() < 1e-9, 1e-9, rise)
        beside = ((center + share[:, None] * away - plane.center) @ plane.axes[:2].T).abs() - plane.half
        there = (share > 0) & (share < 1 + margin / away.norm(dim=1).clamp_min(1e-9))
        found = found | (there & (beside.amax(1) <= reach))
    return found
