"""3DGS and 2DGS trained by gsplat: its rasterizer, its default strategy, the learning rates of the original programs.

An independent program that grows, draws and differentiates by its own code. What it shares with ours: the scene, where
primitives start, the order of the views, and the photometric loss, which has tests of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.initialization import neighbor_distance
from envgs_bench.methods.losses import photometric_loss
from envgs_bench.methods.parameters import SH_DC

SH_DEGREE = 3
NORMAL_WEIGHT, NORMAL_FROM = 0.05, 7_000
REFINE_UNTIL = 15_000


class GsplatModel:
    """What gsplat trains: `train` it, then `render`; `len` is the number of its primitives."""

    def __init__(self, method: str, scene: Scene, steps: int, resets: Iterable[int], prune_opacity: float) -> None:
        """
        Args:
            method: 3dgs or 2dgs.
            resets: steps after which opacities fall to 0.01, as in the original programs. gsplat 1.5.3 never resets
                by itself: its strategy asks for `step % reset_every == 0 & step > 0`, which Python reads as a chain of
                comparisons with `0 & step`, and that is never above 0.
            prune_opacity: its strategy's `prune_opa`, 0.005 by default.
        """
        from gsplat.strategy import DefaultStrategy

        self.surfels, self.steps, self.resets = method == "2dgs", steps, frozenset(resets)
        self.background = scene.background.cuda()
        radius = scene.radius
        self.parameters = torch.nn.ParameterDict(_start(scene, radius)).cuda()
        rates = {"means": 1.6e-4 * radius, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3}
        rates["shN"] = rates["sh0"] / 20
        self.optimizers = {
            name: torch.optim.Adam([{"params": self.parameters[name], "lr": rate}], eps=1e-15)
            for name, rate in rates.items()
        }
        key = "gradient_2dgs" if self.surfels else "means2d"
        self.strategy = DefaultStrategy(prune_opa=prune_opacity, key_for_gradient=key)
        self.state = self.strategy.initialize_state(scene_scale=radius)

    def __len__(self) -> int:
        return len(self.parameters["means"])

    def train(self, views: Iterator[View]) -> None:
        """One step a view. Steps count from 0, as in gsplat's own trainers."""
        for step, view in zip(range(self.steps), views, strict=False):
            self._train_step(step, view)

    @torch.no_grad()
    def render(self, camera: Camera) -> Tensor:
        """[H, W, 3], not clamped."""
        return self._draw(camera, SH_DEGREE)[0]

    def _train_step(self, step: int, view: View) -> None:
        from gsplat.strategy.ops import reset_opa

        color, error, info = self._draw(view.camera, min(step // 1000, SH_DEGREE))
        state = (self.parameters, self.optimizers, self.state, step, info)
        self.strategy.step_pre_backward(*state)
        loss = photometric_loss(color, view.rgb("cuda"))
        if self.surfels and step > NORMAL_FROM:
            loss = loss + NORMAL_WEIGHT * error
        loss.backward()
        for optimizer in self.optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        self.optimizers["means"].param_groups[0]["lr"] *= 0.01 ** (1 / self.steps)
        self.strategy.step_post_backward(*state, packed=False)
        if step in self.resets:
            reset_opa(self.parameters, self.optimizers, self.state, value=0.01)

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


def _start(scene: Scene, radius: float) -> dict[str, Tensor]:
    """A primitive at each point, as large as the distance to its neighbors, with an opacity of 0.1 and random turns."""
    count = len(scene.points)
    points = scene.points.float()
    sh = torch.zeros(count, (SH_DEGREE + 1) ** 2, 3)
    sh[:, 0] = (scene.point_colors - 0.5) / SH_DC
    return {
        "means": points,
        "scales": neighbor_distance(points, radius).log()[:, None].repeat(1, 3),
        "quats": torch.rand(count, 4),
        "opacities": torch.full((count,), math.log(0.1 / 0.9)),
        "sh0": sh[:, :1].clone(),
        "shN": sh[:, 1:].clone(),
    }


Render = Callable[[Camera], Tensor]


@torch.no_grad()
def mean_psnr(render: Render, views: list[View], device: str) -> float:
    """Unweighted mean over views of the PSNR of whole clamped pictures, dB."""
    scores = []
    for view in views:
        image = render(view.camera.to(device)).clamp(0, 1)
        scores.append(-10 * math.log10(float((image - view.rgb(device)).square().mean())))
    return sum(scores) / len(scores)
