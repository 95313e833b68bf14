"""Ref-Gaussian: surfels with materials, lit by a filtered cube map and by each other (Reflective Gaussian Splatting).

A pixel's color is (1 − m)·c + α·w·(V·L + (1 − V)·L_ind): m its metallic share, c its base color, w the reflectance of
the split-sum approximation, L the map filtered for its roughness, and V how freely the mirrored ray leaves the scene.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Camera, GaussianSet, Rendering, Scene, Statistics, View, build_bvh, trace_color
from envgs_bench.core.torch.sh import sh_basis
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, BETA, REFLECTION, MethodCard

from .envmap import EnvMap, EnvMapSettings
from .filtered_map import FilteredMapMethod
from .gaussians.parameters import LearningRates, inverse_sigmoid
from .gaussians.regions import Ball, foreground_ball
from .lighting.brdf_table import specular_weight
from .lighting.shading import colored, mirrored, seen_from
from .lighting.supersampling import averaged, finer
from .settings import PublishedSettings
from .training.losses import edge_aware_smoothness

DIELECTRIC = 0.04  # what a surface that is no metal reflects head-on
METALLIC_ABOVE = 0.02  # m from which normals propagate, and up to which base colors are sabotaged
SMOOTH_BELOW = 0.01  # roughness up to which normals propagate
ALBEDO, ALBEDO_NOISE = 0.5, 0.025  # that materials start with
INDIRECT_DEGREE = 3  # of the indirect light's spherical harmonics
OWN_SURFACE = 0.01  # hits of a mirrored ray nearer than this are of the surface that it leaves, × scene radius
HIDES_WITHIN = 2.0  # what hides the map, around what the cameras look at, × their mean distance from it
MATERIALS = {"roughness_logits": 1, "albedo_logits": 3, "indirect_dc": 3, "indirect_rest": 45}  # fields, their columns


# PublishedSettings stands first, so that all that every Gaussian method has is as in 2DGS's released code.
@dataclass(frozen=True)
class RefGaussianSettings(PublishedSettings, EnvMapSettings):
    """Steps are those of the authors' code, whose runs have 50,000. β is the metallic share m."""

    stretches: bool = False
    longest_run: int = 50_000
    sh_lr: float = 7.5e-3
    sh_from: int = 5_000

    initial_orientation: str = "random"
    densify_until: int = 25_000

    normal_weight: float = 0.05
    normal_reference: str = "alpha"
    normal_rendered: str = "blended"
    mono_weight: float = 0.0
    perceptual_weight: float = 0.0
    smooth_weight: float = 0.0  # weight of the edge-aware smoothness of normals
    smooth_until: int = 18_000  # step up to which that counts

    bootstrap: int = 0
    shade_until: int = 18_000  # step up to which each surfel is shaded, not each pixel; then materials start anew
    indirect_from: int = 20_000  # step after which what hides the map from a pixel lights it
    initial_beta: float = 1e-2
    initial_roughness: float = 0.1  # roughness that surfels start with
    beta_lr: float = 5e-3
    roughness_lr: float = 5e-3  # learning rate of the roughnesses' logits
    albedo_lr: float = 7.5e-3  # learning rate of the albedos' logits
    indirect_lr: float = 7.5e-3  # learning rate of the indirect light's constant term; 1/20 of it for the others
    beta_threshold: float = 0.0
    beta_reset_from: int = 1
    beta_reset: str = "raise"
    envmap_doublings: int = 0

    disturb_every: int = 1_000
    disturb_until: int = 25_000


class RefGaussian(FilteredMapMethod, EnvMap):
    """Ref-Gaussian (Yao et al., ICLR 2025): surfels with materials, lit by a filtered cube map and by each other.

    Metallic share m, roughness, albedo and indirect light are drawn as further channels of the base.

    Attributes:
        deferred: whether pixels are shaded, which follows the shading of surfels.
        indirect: whether what hides the map is traced, and lights in its place.
    """

    card = MethodCard("ref_gaussian", "Ref-Gaussian", 90, "#331A66")
    Settings: ClassVar[type] = RefGaussianSettings
    settings: RefGaussianSettings

    def __init__(self, settings: RefGaussianSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        if not 0 < settings.initial_roughness < 1:
            raise ValueError(f"initial_roughness is {settings.initial_roughness:g}, expected one between 0 and 1")
        self.deferred = self.indirect = False
        self._near = Ball(torch.zeros(3), math.inf)
        self._hides: tuple[GaussianSet, Bvh] | None = None  # what hides the map in an image

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.deferred = self.indirect = False
        around = foreground_ball([view.camera for view in scene.train])
        self._near = Ball(around.center.to(self.device), HIDES_WITHIN * around.radius)

    def before_step(self, step: int) -> None:
        super().before_step(step)
        at, s = self.schedule.at, self.settings
        if self.reflects and not self.deferred and step > at(s.shade_until):
            self.deferred = True
            if s.shade_until > s.bootstrap:
                self._forget_materials()
        self.indirect = self.deferred and step > at(s.indirect_from)

    def phase(self, step: int) -> Hashable:
        return super().phase(step), self.deferred, self.indirect, self._smooths(step)

    def _forget_materials(self) -> None:
        """Materials and the map start again: a surfel's own shading found the shape, and may be wrong about these."""
        parameters = self.sets[BASE].parameters
        for name, values in self.initial_materials(BASE, len(parameters)).items():
            if name.endswith("_logits"):
                parameters.replace(name, values)
        start = torch.full_like(parameters.tensors["beta_logits"].detach(), self.settings.initial_beta)
        parameters.replace("beta_logits", inverse_sigmoid(start))
        self._set_texels(torch.zeros_like(self.texels))

    def prepare(self) -> None:
        super().prepare()
        self._hides = None
        if self.indirect:
            near = self._near_set(None)
            self._hides = near, build_bvh(near, backend=self.settings.backend)

    def base_seen_from(self, camera: Camera, step: int | None) -> GaussianSet:
        gaussians = self.gaussians(BASE, step)
        if not self.reflects:
            return gaussians
        tensors = self.sets[BASE].parameters.tensors
        roughness, albedo = tensors["roughness_logits"].sigmoid(), tensors["albedo_logits"].sigmoid()
        metallic = tensors["beta_logits"].sigmoid()
        directions, normals, _ = seen_from(gaussians, camera.center)
        outgoing, cosine = mirrored(directions, normals)
        if self.deferred:
            indirect = self._indirect_light(outgoing) if self.indirect else torch.zeros_like(albedo)
        else:
            light, reflectance = self.light(step), _reflectance(albedo, metallic)
            specular = light.specular(outgoing, roughness[:, 0])
            specular = specular * specular_weight(reflectance, cosine, roughness[:, 0])
            diffuse = light.irradiance(normals) * (1 - metallic) * albedo
            gaussians, indirect = colored(gaussians, (diffuse + specular).clamp_min(0)), specular
        return replace(gaussians, extras=torch.cat([metallic, roughness, albedo, indirect], dim=1))

    def _indirect_light(self, directions: Tensor) -> Tensor:
        """What comes along `directions` [N, 3] to each surfel from what is near, [N, 3]."""
        tensors = self.sets[BASE].parameters.tensors
        coefficients = torch.cat([tensors["indirect_dc"], tensors["indirect_rest"]], dim=1)
        basis = sh_basis(directions, INDIRECT_DEGREE)[..., None]
        return (basis * coefficients.reshape(len(directions), -1, 3)).sum(1).clamp_min(0)

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.rasterize_base(camera, step)
        statistics = {BASE: base.statistics}
        if not self.reflects:
            return base, statistics
        metallic = base.extras[..., :1]
        if not self.deferred:
            specular = base.extras[..., 5:8]
            layers = {BASE: base.color - specular, REFLECTION: specular, BETA: metallic}
            return replace(base, layers=layers), statistics
        specular = self._specular(base, camera, step)
        alpha = base.alpha[..., None]
        behind = (1 - alpha) * self.background
        own = base.color - behind
        layers = {BASE: base.color, REFLECTION: specular, BETA: metallic}
        return replace(base, color=(1 - metallic) * own + specular + behind, layers=layers), statistics

    def _specular(self, base: Rendering, camera: Camera, step: int | None) -> Tensor:
        """What each pixel mirrors, [H, W, 3]."""
        points = self.settings.supersampling
        base, camera = finer(base, camera, points)
        metallic, roughness, albedo, indirect = base.extras.split([1, 1, 3, 3], dim=-1)
        origins, outgoing, _ = self._reflected_rays(base, camera, step)
        cosine = -(unit(camera.rays()[1]) * unit(base.normal)).sum(-1)
        seen = self.light(step).specular(outgoing.reshape(-1, 3), roughness.reshape(-1)).reshape(albedo.shape)
        if self.indirect:
            free = 1 - self._hidden(origins, outgoing, step)[..., None]
            seen = free * seen + (1 - free) * indirect
        weight = specular_weight(_reflectance(albedo, metallic), cosine, roughness[..., 0])
        return averaged(seen * weight * base.alpha[..., None], points)

    @torch.no_grad()
    def _hidden(self, origins: Tensor, directions: Tensor, step: int | None) -> Tensor:
        """How much of the map the base set hides from each ray, [H, W] from 0 to 1."""
        hides = self._hides if step is None else (self._near_set(step), None)
        assert hides is not None
        near, bvh = hides
        return trace_color(
            near,
            origins.detach(),
            directions.detach(),
            t_min=OWN_SURFACE * self.radius,
            bvh=bvh,
            backend=self.settings.backend,
        )[1]

    def _near_set(self, step: int | None) -> GaussianSet:
        """The surfels that may hide the map, which is what lies beyond them: a far sky among them would hide it all."""
        base = self.gaussians(BASE, step)
        near = (base.means.detach() - self._near.center).norm(dim=1) <= self._near.radius
        opacities = torch.where(near, base.opacities, 0.0)  # not rows of them, for whose number the host would wait
        return replace(base, opacities=opacities, sh=base.sh[:, :1], extras=None).map(Tensor.detach)

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        terms, s = super().losses(rendering, target, view, step), self.settings
        if self._smooths(step):
            terms["smooth"] = s.smooth_weight * edge_aware_smoothness(rendering.normal, target)
        return terms

    def _smooths(self, step: int) -> bool:
        return self.settings.smooth_weight > 0 and step <= self.schedule.at(self.settings.smooth_until)

    def is_sabotaged(self) -> Tensor:
        """Once pixels are shaded; before, there is no base color."""
        return (self.beta() <= METALLIC_ABOVE) & self.deferred

    def spreads(self) -> Tensor:
        roughness = self.sets[BASE].parameters.tensors["roughness_logits"].detach()[:, 0].sigmoid()
        return (self.beta() >= METALLIC_ABOVE) & (roughness <= SMOOTH_BELOW)

    def initial_materials(self, name: str, count: int) -> dict[str, Tensor]:
        noise = ALBEDO_NOISE * (2 * torch.rand(count, 3, generator=self.generator) - 1)
        materials = {name: torch.zeros(count, columns) for name, columns in MATERIALS.items()}
        materials["roughness_logits"] += inverse_sigmoid(torch.tensor(self.settings.initial_roughness))
        materials["albedo_logits"] += inverse_sigmoid(ALBEDO + noise)
        return {name: values.to(self.device) for name, values in materials.items()}

    def initial_learning_rates(self) -> LearningRates:
        s, scale = self.settings, self.schedule.rate_scale
        rates = {
            "roughness_logits": s.roughness_lr * scale,
            "albedo_logits": s.albedo_lr * scale,
            "indirect_dc": s.indirect_lr * scale,
            "indirect_rest": s.indirect_lr * scale / 20,
        }
        return replace(super().initial_learning_rates(), materials=rates)

    def primitive_bytes(self) -> dict[str, int]:
        return {name: size + 4 * sum(MATERIALS.values()) for name, size in super().primitive_bytes().items()}

    def training_state(self) -> dict[str, Any]:
        return super().training_state() | {"deferred": self.deferred, "indirect": self.indirect}

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        super().resume(scene, steps, state)
        self.deferred, self.indirect = state["deferred"], state["indirect"]

    def state(self) -> dict:
        near = {"center": self._near.center, "radius": self._near.radius}
        return super().state() | {"deferred": self.deferred, "indirect": self.indirect, "near_ball": near}

    def restore(self, state: dict) -> None:
        super().restore(state)
        self.deferred, self.indirect = state["deferred"], state["indirect"]
        self._near = Ball(**state["near_ball"])


def _reflectance(albedo: Tensor, metallic: Tensor) -> Tensor:
    """F₀ [..., 3] of albedo [..., 3] and metallic share [..., 1]."""
    return torch.lerp(torch.full_like(albedo, DIELECTRIC), albedo, metallic)
