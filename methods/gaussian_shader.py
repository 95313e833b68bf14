"""GaussianShader: 3D Gaussians shaded one by one, by normals of their own and a filtered cube map.

A Gaussian's color is c_d + s·L(r, ρ) + c_r(ω): c_d its diffuse color, s its tint, L the map filtered for its roughness
ρ, and c_r its residual color (GaussianShader, CVPR 2024, Eq. 3). Its spherical harmonics hold both: c_d is the sigmoid
of b − log 3, where b is what other methods' constant term shows, and c_r are the other terms.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View
from envgs_bench.core.torch.sh import sh_basis
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, BETA, REFLECTION, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.model import GaussianModel
from .gaussians.parameters import SH_DC
from .gaussians.policy import SetPolicy
from .lighting.brdf_table import specular_weight
from .lighting.light_map import CubeMap, Filtered
from .lighting.settings import GaussianShaderSettings
from .lighting.shading import colored, diffuse_color, mirrored, seen_from
from .training.schedule import Part, Schedule, set_rate

INITIAL_TINT, INITIAL_ROUGHNESS = 0.0, 0.6  # logits
INITIAL_LIGHT = 0.8
LEAST_ALPHA = 1e-3  # of the logarithms that make alpha 0 or 1
INNER = "inner_residuals"
MATERIALS = {"tint_logits": 3, "roughness_logits": 1, "outer_residuals": 3, INNER: 3}  # fields, columns


class GaussianShader(GaussianMethod):
    """GaussianShader (Jiang et al., CVPR 2024): 3D Gaussians shaded one by one, by a filtered cube map.

    Normals are shortest axes plus a residual, one for either side that the camera may be on.
    """

    card = MethodCard("gaussian_shader", "GaussianShader", 80, "#B380FF")
    Settings: ClassVar[type] = GaussianShaderSettings
    settings: GaussianShaderSettings
    axes = 3
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: GaussianShaderSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.light = Filtered(CubeMap(self.model, settings))
        self.model.shade = self._shaded
        rates = DecayingRates(self.model, settings, self.light.map)
        self.parts = {"map": self.light.map, "filtered": self.light, "rates": rates}

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        base = super().policies(schedule, scene)[BASE]
        rates = dict.fromkeys(MATERIALS, self.settings.material_lr)
        rates[INNER] = self.settings.inner_lr * schedule.rate_scale
        return {BASE: base.with_materials(self._materials, MATERIALS, rates)}

    def _materials(self, count: int) -> dict[str, Tensor]:
        materials = {name: torch.zeros(count, columns, device=self.device) for name, columns in MATERIALS.items()}
        materials["tint_logits"] += INITIAL_TINT
        materials["roughness_logits"] += INITIAL_ROUGHNESS
        return materials

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        size = self.settings.envmap_size
        self.light.map.show(torch.full((6, size, size, 3), INITIAL_LIGHT))

    def _shaded(self, gaussians: GaussianSet, camera: Camera, step: int | None) -> GaussianSet:
        """The shaded Gaussians; their extras are tint, normal's residual, normal [3] and reflected color [3]."""
        tensors = self.model.sets[BASE].parameters.tensors
        tint, roughness = tensors["tint_logits"].sigmoid(), tensors["roughness_logits"][:, 0].sigmoid()
        directions, axes, turned = seen_from(gaussians, camera.center, self.settings.rule.shortest_axis)
        residual = torch.where(turned, tensors["inner_residuals"], tensors["outer_residuals"])
        normals = unit(axes + residual)
        outgoing, cosine = mirrored(directions, normals)
        light = self.light.at(step)
        specular = light.specular(outgoing, roughness) * specular_weight(tint, cosine, roughness)
        reflected = specular + (1 - tint) * light.irradiance(normals)
        colors = own_color(gaussians.sh, directions) + reflected
        length = residual.square().sum(1, keepdim=True).clamp_min(1e-12).sqrt()
        extras = torch.cat([tint.mean(1, keepdim=True), length, normals, reflected], dim=1)
        return replace(colored(gaussians, colors), extras=extras)

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.model.rasterize(camera, step)
        tint, _, normal, reflected = base.extras.split([1, 1, 3, 3], dim=-1)
        layers = {BASE: base.color - reflected, REFLECTION: reflected, BETA: tint}
        return replace(base, normal=normal, layers=layers), {BASE: base.statistics}

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """Normals are held to the depth map, which is not moved by them (Ref-NeRF's predicted normals)."""
        s, alpha = self.settings, rendering.alpha.detach()
        held = replace(rendering, depth=rendering.depth.detach())
        if s.rule.normal_drawn == "as_color":
            held = drawn_as_color(held, self.model.background)
        terms = super().losses(held, target, view, step)
        weight = self.runner.loss.pixel_weights(held)
        if s.rule.normal_drawn == "as_color" and "normal" in terms:  # the depth map's normals, too, lie over it
            behind = (held.normal * self.model.background).sum(-1) * (1 - alpha)
            terms["normal"] = terms["normal"] - s.normal_weight * (behind if weight is None else weight * behind).mean()
        length = rendering.extras[..., 1]
        terms["residual"] = s.residual_weight * ((alpha if weight is None else weight) * length).mean()
        clear = rendering.alpha.clamp(LEAST_ALPHA, 1 - LEAST_ALPHA)
        terms["sparse"] = s.sparse_weight * (clear.log() + (1 - clear).log()).mean()
        return terms


def drawn_as_color(rendering: Rendering, background: Tensor) -> Rendering:
    """Normals and depths as GaussianShader's code has them, which draws n/2 + 1/2 and depths as it draws colors.

    Depths are so not divided by alpha; and where alpha is below 1, the background [3] is a part of both.
    """
    behind = (1 - rendering.alpha)[..., None]
    depth = rendering.depth * rendering.alpha.detach() + background[0] * behind[..., 0].detach()
    return replace(rendering, normal=rendering.normal + (2 * background - 1) * behind, depth=depth)


def own_color(sh: Tensor, directions: Tensor) -> Tensor:
    """c_d + c_r [N, 3] of spherical harmonics [N, K, 3], seen along unit `directions` [N, 3]."""
    degree = math.isqrt(sh.shape[1]) - 1
    residual = (sh_basis(directions, degree)[:, 1:, None] * sh[:, 1:]).sum(1)
    return diffuse_color(sh) + residual


class DecayingRates(Part):
    """The rates of the colors, the materials and the map, which fall log-linearly over a run."""

    def __init__(self, model: GaussianModel, settings: GaussianShaderSettings, light: CubeMap) -> None:
        self._model, self._settings, self._light = model, settings, light

    def begin_step(self, step: int) -> None:
        s, schedule = self._settings, self._model.schedule
        rate, parameters = schedule.rate(step, s.material_lr, s.material_lr_final), self._model.sets[BASE].parameters
        for name in MATERIALS.keys() - {INNER}:
            parameters.set_learning_rate(name, rate * schedule.rate_scale)
        parameters.set_learning_rate("sh_dc", rate / SH_DC * schedule.rate_scale)  # so that c_d's logits learn at it
        set_rate(self._light.optimizer.param_groups[0], schedule.rate(step, s.envmap_lr, s.material_lr_final))
