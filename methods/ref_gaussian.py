"""Ref-Gaussian: surfels with materials, lit by a filtered cube map and by each other (Reflective Gaussian Splatting).

A pixel's color is (1 − m)·c + α·w·(V·L + (1 − V)·L_ind): m its metallic share, c its base color, w the reflectance of
the split-sum approximation, L the map filtered for its roughness, and V how freely the mirrored ray leaves the scene.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, BETA, REFLECTION, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.parameters import inverse_sigmoid
from .gaussians.policy import SetPolicy
from .lighting.brdf_table import specular_weight
from .lighting.disturbance import Disturbance, beta_of, reflecting_policy
from .lighting.light_map import CubeMap, Filtered
from .lighting.occlusion import Occluders
from .lighting.reflection import Reflection
from .lighting.settings import RefGaussianSettings
from .lighting.shading import colored, from_sides, mirrored, reflectance_of, seen_from
from .lighting.supersampling import averaged, finer
from .training.losses import edge_aware_smoothness
from .training.schedule import Part, Schedule

METALLIC_ABOVE = 0.02  # m from which normals propagate, and up to which base colors are sabotaged
SMOOTH_BELOW = 0.01  # roughness up to which normals propagate
LEAST_ALPHA = 1e-6  # that a blended normal is divided by
ALBEDO, ALBEDO_NOISE = 0.5, 0.025  # that materials start with
MATERIALS = {"roughness_logits": 1, "albedo_logits": 3, "indirect_dc": 3, "indirect_rest": 45}  # fields, their columns


class RefGaussian(GaussianMethod):
    """Ref-Gaussian (Yao et al., ICLR 2025): surfels with materials, lit by a filtered cube map and by each other.

    Metallic share m, roughness, albedo and indirect light are drawn as further channels of the base.
    """

    card = MethodCard("ref_gaussian", "Ref-Gaussian", 90, "#331A66")
    Settings: ClassVar[type] = RefGaussianSettings
    settings: RefGaussianSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: RefGaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        light = CubeMap(self.model, settings, settings.envmap_doublings)
        self.reflection = Reflection(self.model, settings, light)
        self.surfaces = Surfaces(self, settings, self.reflection, light)
        disturbance = Disturbance(self.model, settings)
        disturbance.is_sabotaged, disturbance.spreads = self.surfaces.is_sabotaged, self.surfaces.spreads
        self.model.shade = self.surfaces.shaded
        self.parts = {
            "reflection": self.reflection,
            "disturbance": disturbance,
            "filtered": self.surfaces.filtered,
            "occluders": self.surfaces.occluders,
            "surfaces": self.surfaces,
        }

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        s, scale = self.settings, schedule.rate_scale
        rates = {
            "roughness_logits": s.roughness_lr * scale,
            "albedo_logits": s.albedo_lr * scale,
            "indirect_dc": s.indirect_lr * scale,
            "indirect_rest": s.indirect_lr * scale / 20,
        }
        base = reflecting_policy(s, schedule, scene)
        return {BASE: base.with_materials(self._materials, MATERIALS, rates)}

    def _materials(self, count: int) -> dict[str, Tensor]:
        noise = ALBEDO_NOISE * (2 * torch.rand(count, 3, generator=self.generator) - 1)
        materials = {name: torch.zeros(count, columns) for name, columns in MATERIALS.items()}
        materials["roughness_logits"] += inverse_sigmoid(torch.tensor(self.settings.initial_roughness))
        materials["albedo_logits"] += inverse_sigmoid(ALBEDO + noise)
        return {name: values.to(self.device) for name, values in materials.items()}

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.model.rasterize(camera, step)
        return self.surfaces.lit(base, camera, step), {BASE: base.statistics}

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        terms, s = super().losses(rendering, target, view, step), self.settings
        if self._smooths(step):
            terms["smooth"] = s.smooth_weight * edge_aware_smoothness(rendering.normal, target)
        return terms

    def phase(self, step: int) -> Hashable:
        return super().phase(step), self._smooths(step)

    def _smooths(self, step: int) -> bool:
        return self.settings.smooth_weight > 0 and step <= self.model.schedule.at(self.settings.smooth_until)


class Surfaces(Part):
    """How surfaces look: each surfel's shading at first, each pixel's later.

    Attributes:
        deferred: whether pixels are shaded, which follows the shading of surfels.
        filtered: the map, filtered for roughness.
        occluders: what hides it; traced late in a training, when it lights in the map's place.
    """

    def __init__(
        self, method: GaussianMethod, settings: RefGaussianSettings, reflection: Reflection, light: CubeMap
    ) -> None:
        self.deferred = False
        self.filtered, self.occluders = Filtered(light), Occluders(method.model)
        self._model, self._settings, self._reflection, self._light = method.model, settings, reflection, light

    def start(self, scene: Scene) -> None:
        self.deferred = False

    def begin_step(self, step: int) -> None:
        at, s = self._model.schedule.at, self._settings
        if self._reflection.begun and not self.deferred and step > at(s.shade_until):
            self.deferred = True
            if self._shades_surfels():
                self._forget_materials()
        self.occluders.traced = self.deferred and step > at(s.indirect_from)

    def phase(self, step: int) -> Hashable:
        return self.deferred, self.occluders.traced

    def training_state(self) -> dict[str, Any]:
        return {"deferred": self.deferred}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.deferred = state["deferred"]

    def state(self) -> dict[str, Any]:
        return {"deferred": self.deferred}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.deferred = state["deferred"]

    def shaded(self, gaussians: GaussianSet, camera: Camera, step: int | None) -> GaussianSet:
        """With metallic share, roughness, albedo and indirect light as extras, [N, 8], and shaded unless pixels are."""
        if not self._reflection.begun:
            return gaussians
        tensors = self._model.sets[BASE].parameters.tensors
        roughness, albedo = tensors["roughness_logits"].sigmoid(), tensors["albedo_logits"].sigmoid()
        metallic = tensors["beta_logits"].sigmoid()
        directions, normals, _ = seen_from(gaussians, camera.center)
        outgoing, cosine = mirrored(directions, normals)
        if self.deferred and self.occluders.traced:
            indirect = from_sides(outgoing, tensors["indirect_dc"], tensors["indirect_rest"])
        elif self.deferred:
            indirect = torch.zeros_like(albedo)
        else:
            light, reflectance = self.filtered.at(step), reflectance_of(albedo, metallic)
            specular = light.specular(outgoing, roughness[:, 0])
            specular = specular * specular_weight(reflectance, cosine, roughness[:, 0])
            diffuse = light.irradiance(normals) * (1 - metallic) * albedo
            gaussians, indirect = colored(gaussians, (diffuse + specular).clamp_min(0)), specular
        return replace(gaussians, extras=torch.cat([metallic, roughness, albedo, indirect], dim=1))

    def lit(self, base: Rendering, camera: Camera, step: int | None) -> Rendering:
        """The picture of what `shaded` surfels are rasterized to."""
        if not self._reflection.begun:
            return base
        metallic = base.extras[..., :1]
        if not self.deferred:
            specular = base.extras[..., 5:8]
            return replace(base, layers={BASE: base.color - specular, REFLECTION: specular, BETA: metallic})
        specular = self._specular(base, camera, step)
        behind = (1 - base.alpha[..., None]) * self._model.background
        own = base.color - behind
        layers = {BASE: base.color, REFLECTION: specular, BETA: metallic}
        return replace(base, color=(1 - metallic) * own + specular + behind, layers=layers)

    def _shades_surfels(self) -> bool:
        """Whether surfels are shaded before pixels are; the authors' commands for captures leave that out."""
        return self._settings.shade_until > self._settings.warm_up

    def is_sabotaged(self) -> Tensor:
        """Whose base color is disturbed, [N]; none before pixels are shaded, and none where surfels never were."""
        return (beta_of(self._model) <= METALLIC_ABOVE) & (self.deferred and self._shades_surfels())

    def spreads(self) -> Tensor:
        """What normal propagation enlarges, [N]: smooth metal."""
        roughness = self._model.sets[BASE].parameters.tensors["roughness_logits"].detach()[:, 0].sigmoid()
        return (beta_of(self._model) >= METALLIC_ABOVE) & (roughness <= SMOOTH_BELOW)

    def _specular(self, base: Rendering, camera: Camera, step: int | None) -> Tensor:
        """What each pixel mirrors, [H, W, 3].

        Mirrored at the mean normal of what is blended, which is shorter than 1 where those disagree, as in the authors'
        code: such a pixel looks ahead, rather than along a mirrored ray.
        """
        s = self._settings
        points = s.supersampling
        base, camera = finer(base, camera, points)
        metallic, roughness, albedo, indirect = base.extras.split([1, 1, 3, 3], dim=-1)
        normal = (base.normal if s.joint else base.normal.detach()) / base.alpha.clamp_min(LEAST_ALPHA)[..., None]
        outgoing, cosine = mirrored(unit(camera.rays()[1]), normal)
        outgoing = unit(outgoing)
        seen = self.filtered.at(step).specular(outgoing.reshape(-1, 3), roughness.reshape(-1)).reshape(albedo.shape)
        if self.occluders.traced:
            origins, _, _ = self._reflection.rays(base, camera, step)
            free = 1 - self.occluders.hidden(origins, outgoing, step)[..., None]
            seen = free * seen + (1 - free) * indirect
        weight = specular_weight(reflectance_of(albedo, metallic), cosine, roughness[..., 0])
        return averaged(seen * weight * base.alpha[..., None], points)

    def _forget_materials(self) -> None:
        """Materials and the map start again: a surfel's own shading found the shape, and may be wrong about these."""
        parameters = self._model.sets[BASE].parameters
        for name, values in self._model.policies[BASE].start.materials(len(parameters)).items():
            if name.endswith("_logits"):
                parameters.replace(name, values)
        start = torch.full_like(parameters.tensors["beta_logits"].detach(), self._settings.initial_beta)
        parameters.replace("beta_logits", inverse_sigmoid(start))
        self._light.become(torch.zeros_like(self._light.texels))
