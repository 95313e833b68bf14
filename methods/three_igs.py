"""3iGS: 3D Gaussians with features of their BRDF, in an illumination field over the scene (Factorised Tensorial
Illumination for 3D Gaussian Splatting).

A Gaussian's color is c_d + F(ρ, L, ω): c_d its diffuse color, ρ its features, L the field at its center, and F a small
network that sees the viewing direction ω blurred by the Gaussian's roughness. There are no normals.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE, ENV, REFLECTION, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.initialization import quantile_box
from .gaussians.model import GaussianModel
from .gaussians.parameters import SH_DC
from .gaussians.policy import SetPolicy
from .lighting import directional_encoding
from .lighting.directional_encoding import encoded
from .lighting.settings import ThreeIGSSettings
from .lighting.shading import colored, diffuse_color
from .lighting.tensor_field import field_components
from .training.optimizer import adam, detached, optimizer_state, restore_optimizer
from .training.schedule import Part, Schedule

COMPONENTS = 48  # of each mode of the field
FEATURES = 48  # of the field at a place, and of a Gaussian's BRDF: as many as 3DGS has spherical harmonics
WIDTH = 128  # of the network's two hidden layers
SEEN = 2 * FEATURES + 3 + directional_encoding.SIZE  # numbers that the network sees
INITIAL_COMPONENT = 0.01  # standard deviation of the planes and lines
BOX_QUANTILE = 0.96  # of the points that the field's box holds along each axis, around the middle
ADAM = {"betas": (0.9, 0.99), "eps": 1e-8}  # of the field and the network
MATERIALS = {"brdf_logits": FEATURES, "roughness": 1}  # fields, columns; logits, as tanh x is 2·sigmoid(2x) − 1
GRIDS = ("planes", "lines")


class ThreeIGS(GaussianMethod):
    """3iGS (Tang and Cham, ECCV 2024): 3D Gaussians with features of their BRDF, in a factorized illumination field."""

    card = MethodCard("3igs", "3iGS", 70, "#FFCCFF")
    Settings: ClassVar[type] = ThreeIGSSettings
    settings: ThreeIGSSettings
    axes = 3
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: ThreeIGSSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.field = IlluminationField(self.model, settings)
        self.model.shade = self.field.shaded
        self.parts = {"field": self.field}

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        base = super().policies(schedule, scene)[BASE]
        rate = self.settings.brdf_lr * schedule.rate_scale
        return {BASE: base.with_materials(self._materials, MATERIALS, dict.fromkeys(MATERIALS, rate))}

    def _materials(self, count: int) -> dict[str, Tensor]:
        roughness = torch.rand(count, 1, generator=self.generator)
        return {"brdf_logits": torch.zeros(count, FEATURES, device=self.device), "roughness": roughness.to(self.device)}

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.model.rasterize(camera, step)
        if step is None and self.field.shines:
            base = replace(base, layers={BASE: base.color - base.extras, REFLECTION: base.extras})
        return base, {BASE: base.statistics}


class IlluminationField(Part):
    """The field and the network, which make specular color of Gaussians' features.

    Attributes:
        shines: whether there is specular color, which follows the training of the diffuse color.
        weights: the field and the network, by name; see `weight_shapes`.
    """

    def __init__(self, model: GaussianModel, settings: ThreeIGSSettings) -> None:
        self.shines = False
        self._model, self._settings = model, settings
        self._box = (-torch.ones(3), torch.ones(3))
        self._become({name: torch.zeros(shape) for name, shape in weight_shapes(settings.field_size).items()})

    def start(self, scene: Scene) -> None:
        self.shines = False
        low, high = quantile_box(scene.points.float(), BOX_QUANTILE)
        self._box = (low.to(self._model.device), high.to(self._model.device))
        self._become(initial_weights(self._settings.field_size, self._model.generator))
        parameters = self._model.sets[BASE].parameters  # features begin as the color and nothing else
        features = torch.zeros_like(parameters.tensors["brdf_logits"].detach())
        features[:, :3] = parameters.tensors["sh_dc"].detach()[:, 0]
        parameters.replace("brdf_logits", features)
        shown = torch.rand(len(features), 1, 3, generator=self._model.generator).to(features)  # b, at random
        parameters.replace("sh_dc", (shown - 0.5) / SH_DC)

    def begin_step(self, step: int) -> None:
        schedule = self._model.schedule
        self.shines = step > schedule.at(self._settings.diffuse_until)
        rate = self._settings.sh_lr / SH_DC * schedule.rate_scale  # so that b learns at it
        self._model.sets[BASE].parameters.set_learning_rate("sh_dc", rate)

    def phase(self, step: int) -> Hashable:
        return self.shines

    def shaded(self, gaussians: GaussianSet, camera: Camera, step: int | None) -> GaussianSet:
        """The shaded Gaussians; those of an image have what their color is more than diffuse as extras, [N, 3]."""
        diffuse = diffuse_color(gaussians.sh)
        if not self.shines:
            return colored(gaussians, diffuse)
        directions = unit(gaussians.means - camera.center)
        colors = (diffuse + self._specular(gaussians.means.detach(), directions)).clamp(0, 1)
        extras = colors - diffuse if step is None else None
        return replace(colored(gaussians, colors), extras=extras)

    def _specular(self, means: Tensor, directions: Tensor) -> Tensor:
        """The network's colors [N, 3] in [−1, 1] of Gaussians at `means` [N, 3], seen along `directions` [N, 3]."""
        tensors, w = self._model.sets[BASE].parameters.tensors, self.weights
        low, high = self._box
        places = (means - low) / (high - low) * 2 - 1
        light = functional.linear(field_components(w["planes"], w["lines"], places), w["light_weight"], w["light_bias"])
        direction = encoded(directions, functional.softplus(tensors["roughness"] - 1))
        seen = torch.cat([tensors["brdf_logits"].tanh(), light.tanh(), directions, direction], dim=1)
        for layer in ("first", "second"):
            seen = functional.linear(seen, w[f"{layer}_weight"], w[f"{layer}_bias"]).relu()
        return functional.linear(seen, w["color_weight"]).tanh()

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return (self._optimizer,)

    def most_bytes(self) -> int:
        return 4 * sum(map(math.prod, weight_shapes(self._settings.field_size).values()))

    def model_bytes(self) -> dict[str, int]:
        return {ENV: self.most_bytes()}

    def training_state(self) -> dict[str, Any]:
        moments = optimizer_state(self._optimizer, self.weights)
        return {"weights": detached(self.weights), "moments": moments, "shines": self.shines}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self._become(state["weights"])
        restore_optimizer(self._optimizer, self.weights, state["moments"])
        self.shines = state["shines"]

    def state(self) -> dict[str, Any]:
        low, high = self._box
        return detached(self.weights) | {"shines": self.shines, "field_box": {"low": low, "high": high}}

    def restore(self, state: Mapping[str, Any]) -> None:
        size = state["lines"].shape[1]
        if size != self._settings.field_size:
            raise ValueError(
                f"the checkpoint's field has {size} samples along an axis, field_size is {self._settings.field_size}"
            )
        self._become({name: state[name] for name in weight_shapes(size)})
        self.shines = state["shines"]
        self._box = (state["field_box"]["low"], state["field_box"]["high"])

    def _become(self, weights: Mapping[str, Tensor]) -> None:
        s, device = self._settings, self._model.device
        self.weights = {name: values.detach().to(device).requires_grad_() for name, values in weights.items()}
        self._optimizer = adam(
            [
                {"params": [weight], "name": name, "lr": s.field_lr if name in GRIDS else s.network_lr, **ADAM}
                for name, weight in self.weights.items()
            ]
        )


def weight_shapes(field_size: int) -> dict[str, tuple[int, ...]]:
    """The shapes of the field's planes and lines, of what makes light of their components, and of the network."""
    return {
        "planes": (3, field_size, field_size, COMPONENTS),
        "lines": (3, field_size, COMPONENTS),
        "light_weight": (FEATURES, 3 * COMPONENTS),
        "light_bias": (FEATURES,),
        "first_weight": (WIDTH, SEEN),
        "first_bias": (WIDTH,),
        "second_weight": (WIDTH, WIDTH),
        "second_bias": (WIDTH,),
        "color_weight": (3, WIDTH),
    }


def initial_weights(field_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    """Small normal planes and lines; layers uniform within ± 1/√inputs, as PyTorch's, biases like their weights."""
    weights: dict[str, Tensor] = {}
    bound = 0.0
    for name, shape in weight_shapes(field_size).items():
        if name in GRIDS:
            weights[name] = INITIAL_COMPONENT * torch.randn(shape, generator=generator)
            continue
        if len(shape) == 2:
            bound = shape[1] ** -0.5
        weights[name] = bound * (2 * torch.rand(shape, generator=generator) - 1)
    return weights
