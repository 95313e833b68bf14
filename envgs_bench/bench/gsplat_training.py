"""3DGS and 2DGS trained by gsplat: its rasterizer, its strategies, the learning rates of the original programs.

An independent program that grows, draws and differentiates by its own code. What it shares with ours: the scene, where
primitives start, the order of the views, and the photometric loss, which has tests of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.gaussians.initialization import neighbor_distance
from envgs_bench.methods.gaussians.parameters import sh_from_rgb
from envgs_bench.methods.recipes import REFERENCE_STEPS
from envgs_bench.methods.training.losses import photometric_loss
from envgs_bench.methods.training.resident_views import ResidentViews
from envgs_bench.methods.training.schedule import DENSIFY_FLOOR

RECIPES = ("3dgs", "2dgs", "3dgs_mcmc")  # its default strategy, but for the last, which has the other one
SH_DEGREE, SH_EVERY = 3, 1_000
NORMAL_WEIGHT, NORMAL_FROM = 0.05, 7_000
REFINE_UNTIL = 15_000
PRUNE_OPACITY = {"3dgs": 0.005, "2dgs": 0.05}
MCMC_WEIGHT = 0.01  # of the mean opacity and of the mean scale in the loss of its trainer for that strategy
MCMC_OPACITY, MCMC_SCALE = 0.5, 0.1  # that primitives then start with; the scale × the distance to their neighbors


class GsplatTraining:
    """What gsplat trains, step by step, see `course.Trainee`; `len` is the number of its primitives."""

    def __init__(
        self, recipe: str, resets: Iterable[int] = (), prune_opacity: float | None = None, scaled: bool = False
    ) -> None:
        """
        Args:
            recipe: one of RECIPES.
            resets: steps, from 0, after which opacities fall to 0.01, as in the original programs. gsplat 1.5.3
                never resets by itself: its strategy asks for `step % reset_every == 0 & step > 0`, which Python reads
                as a chain of comparisons with `0 & step`, and that is never above 0.
            prune_opacity: its default strategy's `prune_opa`; the original program's where None.
            scaled: whether a run of other than 30,000 steps shrinks or stretches all that happens at some step, as
                `steps_scaler` of its trainers does; growth stays as far apart as ours at least.
        """
        self.recipe, self.resets, self.scaled = recipe, frozenset(resets), scaled
        self.surfels, self.mcmc = recipe == "2dgs", recipe == "3dgs_mcmc"
        self._prune_opacity = prune_opacity

    def __len__(self) -> int:
        return len(self.parameters["means"])

    def start(self, scene: Scene, steps: int) -> None:
        """Forget everything, and begin with the scene's points."""
        self.steps = steps
        self.background = scene.background.cuda()
        radius = scene.radius
        self.parameters = torch.nn.ParameterDict(_start(scene, radius, self.mcmc)).cuda()
        rates = {"means": 1.6e-4 * radius, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3}
        rates["shN"] = rates["sh0"] / 20
        self.optimizers = {
            name: torch.optim.Adam([{"params": self.parameters[name], "lr": rate}], eps=1e-15)
            for name, rate in rates.items()
        }
        self._begin_strategy(radius)
        self._views = ResidentViews.of(self.background.device)
        self._seen = {view.name: replace(view, normal=None) for view in scene.train}  # it asks for no normals

    def training_step(self, view: View, step: int) -> None:
        """Step number `step`, from 1; gsplat's own trainers count from 0."""
        from gsplat.strategy.ops import reset_opa

        view, step = self._views.on_device(self._seen[view.name]), step - 1
        color, error, info = self._draw(view.camera, min(step // self._at(SH_EVERY), SH_DEGREE))
        state = (self.parameters, self.optimizers, self.state, step, info)
        self.strategy.step_pre_backward(*state)
        loss = photometric_loss(color, view.rgb("cuda"))
        if self.surfels and step > self._at(NORMAL_FROM):
            loss = loss + NORMAL_WEIGHT * error
        if self.mcmc:
            opacities, scales = self.parameters["opacities"].sigmoid(), self.parameters["scales"].exp()
            loss = loss + MCMC_WEIGHT * (opacities.mean() + scales.mean())
        loss.backward()
        for optimizer in self.optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        positions = self.optimizers["means"].param_groups[0]
        positions["lr"] *= 0.01 ** (1 / self.steps)
        self.strategy.step_post_backward(*state, **({"lr": positions["lr"]} if self.mcmc else {"packed": False}))
        if step in self.resets:
            reset_opa(self.parameters, self.optimizers, self.state, value=0.01)

    def settle(self) -> None:
        """Nothing is left under way but what the device does."""

    @torch.no_grad()
    def picture(self, camera: Camera) -> Tensor:
        """[H, W, 3], not clamped."""
        return self._draw(camera, SH_DEGREE)[0]

    def _begin_strategy(self, radius: float) -> None:
        from gsplat.strategy import DefaultStrategy, MCMCStrategy

        if self.mcmc:
            self.strategy = MCMCStrategy(
                refine_start_iter=self._at(500), refine_stop_iter=self._at(25_000), refine_every=self._refine_every()
            )
            self.state = self.strategy.initialize_state()
            return
        chosen = self._prune_opacity
        self.strategy = DefaultStrategy(
            prune_opa=PRUNE_OPACITY[self.recipe] if chosen is None else chosen,
            refine_start_iter=self._at(500),
            refine_stop_iter=self._at(REFINE_UNTIL),
            reset_every=self._at(3_000),
            refine_every=self._refine_every(),
            key_for_gradient="gradient_2dgs" if self.surfels else "means2d",
        )
        self.state = self.strategy.initialize_state(scene_scale=radius)

    def _refine_every(self) -> int:
        return max(DENSIFY_FLOOR, self._at(100))

    def _at(self, reference_step: int) -> int:
        """A step or an interval of a run of 30,000 in this run's steps."""
        return max(1, reference_step * self.steps // REFERENCE_STEPS) if self.scaled else reference_step

    def _draw(self, camera: Camera, sh_degree: int) -> tuple[Tensor, Tensor, dict]:
        """The picture [H, W, 3], the mean error of its normals against the depth map's × alpha, and gsplat's `info`."""
        from gsplat import rasterization, rasterization_2dgs

        camera, p = camera.to("cuda"), self.parameters
        shared = {
            **{"means": p["means"], "quats": p["quats"], "scales": p["scales"].exp()},
            **{"opacities": p["opacities"].sigmoid(), "colors": torch.cat([p["sh0"], p["shN"]], dim=1)},
            **{"viewmats": camera.world_to_camera[None], "Ks": camera.intrinsics[None]},
            **{"width": camera.width, "height": camera.height, "near_plane": 0.2, "packed": False},
            **{"sh_degree": sh_degree, "backgrounds": self.background[None]},
        }
        if not self.surfels:
            color, _, info = rasterization(**shared)
            return color[0], color.new_zeros(()), info
        color, alpha, normal, of_depth, _, _, info = rasterization_2dgs(**shared, render_mode="RGB+ED")
        reference = of_depth.reshape(normal.shape) * alpha.detach()
        return color[0, ..., :3], (1 - (normal * reference).sum(-1)).mean(), info


def official_resets(scene: Scene, steps: int) -> list[int]:
    """Steps, counted from 0, after which the original programs reset opacities."""
    resets = list(range(3000, min(steps, REFINE_UNTIL), 3000))
    on_white = bool((scene.background == 1).all())
    return [500, *resets] if on_white and steps > 500 else resets


def _start(scene: Scene, radius: float, mcmc: bool) -> dict[str, Tensor]:
    """A primitive at each point, as large as the distance to its neighbors, with an opacity of 0.1 and random turns."""
    count = len(scene.points)
    points = scene.points.float()
    constant, others = sh_from_rgb(scene.point_colors.float(), SH_DEGREE)
    scale, opacity = (MCMC_SCALE, MCMC_OPACITY) if mcmc else (1.0, 0.1)
    return {
        "means": points,
        "scales": (scale * neighbor_distance(points, radius)).log()[:, None].repeat(1, 3),
        "quats": torch.rand(count, 4),
        "opacities": torch.full((count,), math.log(opacity / (1 - opacity))),
        "sh0": constant,
        "shN": others,
    }
