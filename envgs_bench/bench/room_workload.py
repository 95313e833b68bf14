"""The room as a workload: of any size, with a model of each method whose sets are the room's."""

from __future__ import annotations

from functools import lru_cache
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import normalize

from envgs_bench.core import GaussianSet, Scene, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.lighting.settings import MapSettings
from envgs_bench.methods.registry import create_method
from envgs_bench.parts import BASE, ENV

from .cases import METHODS, Case
from .room import EYE, TARGET, reflected_rays, room_camera, room_gaussians
from .workload import Model, Workload

BASE_SHARE = 5  # base surfels for each of the environment's, as in the paper's scenes
BETA = 0.5  # every pixel reflects
STEPS = 30_000
STEP = 25_001  # past all densifications and resets, and a map has its full size
NEAR = 0.2  # world units
ADAM_METHOD = "2dgs"  # whose parameters Adam moves
LOOKED_AT = (*METHODS, "adam", "ssim")  # operations that need a photograph, which takes memory


class RoomWorkload(Workload):
    """What `case` asks of the room, on `device`."""

    def __init__(self, case: Case, device: torch.device) -> None:
        self.near = NEAR
        self._case, self._device = case, device
        self._kind = case.op if case.op in METHODS else ADAM_METHOD
        self._size = (case.width or 16, case.height or 16)  # where no picture is drawn, of what is not looked at
        self.views = [self._view()]

    def rasterized(self, view: View) -> GaussianSet:
        columns = 3 if self._case.op in ("rasterize_3d", "rasterize_3d_color") else 2
        return _room(self._case.primitives, columns).to(self._device)

    def traced(self) -> GaussianSet:
        return _room(self._case.primitives, 2).to(self._device)

    def rays(self, view: View) -> tuple[Tensor, Tensor]:
        origins, directions = reflected_rays(*self._size)
        return origins.to(self._device), directions.to(self._device)

    def texels(self) -> Tensor:
        return _texels(MapSettings().envmap_size).to(self._device)

    def model(self) -> Model:
        settings = {"backend": self._case.backend}
        method = cast(GaussianMethod, create_method(self._kind, settings, self._device))
        view = self.views[0]
        points = room_gaussians(16).means  # of a first set, which the room's takes the place of
        method.initialize(Scene("room", [view], [view], points, torch.full_like(points, 0.5)), STEPS)
        method.restore(self._state(method))
        return Model(method, self.views, STEP)

    def _view(self) -> View:
        """A random photograph with random normals, or for what needs none a camera alone."""
        width, height = self._size
        if self._case.op not in LOOKED_AT:
            return View("room", room_camera(width, height).to(self._device), torch.empty(0, 0, 3, dtype=torch.uint8))
        generator = torch.Generator().manual_seed(0)
        image = torch.randint(0, 256, (height, width, 3), generator=generator, dtype=torch.uint8)
        normal = normalize(torch.randn(height, width, 3, generator=generator), dim=-1)
        camera = room_camera(width, height)
        return View("room", camera.to(self._device), image.to(self._device), normal=normal.to(self._device))

    def _state(self, method: GaussianMethod) -> dict:
        """What the method's `restore` takes: of EnvGS with BASE_SHARE times as many surfels in the base."""
        count, has_beta = self._case.primitives, method.model.policies[BASE].start.beta is not None
        if self._kind == "envgs":
            sets = {BASE: _parameters(BASE_SHARE * count, 2, BETA), ENV: _parameters(count, 2, None)}
        else:
            sets = {BASE: _parameters(count, method.axes, BETA if has_beta else None)}
        state = {
            "sets": {
                name: {field: x.to(self._device) for field, x in tensors.items()} for name, tensors in sets.items()
            },
            "radius": float((EYE - TARGET).norm()),
            "near": method.model.near,
            "background": torch.zeros(3, device=self._device),
            "reflects": True,
        }
        if isinstance(method.settings, MapSettings):
            state["texels"] = _texels(method.settings.envmap_size).to(self._device)
        return state


@lru_cache(maxsize=2)  # cases of equal sets follow each other, and millions of Gaussians take seconds to make
def _room(count: int, columns: int) -> GaussianSet:
    return room_gaussians(count, columns=columns)


def _parameters(count: int, columns: int, beta: float | None) -> dict[str, Tensor]:
    """The room's Gaussians as what Adam moves, see GaussianParameters."""
    room = _room(count, columns)
    tensors = {
        "means": room.means,
        "quaternions": room.quaternions,
        "log_scales": room.scales.log(),
        "opacity_logits": torch.logit(room.opacities, eps=1e-6),
        "sh_dc": room.sh[:, :1].contiguous(),
        "sh_rest": room.sh[:, 1:].contiguous(),
    }
    if beta is not None:
        tensors["beta_logits"] = torch.logit(torch.full((count, 1), beta))
    return tensors


def _texels(size: int) -> Tensor:
    return torch.randn(6, size, size, 3, generator=torch.Generator().manual_seed(0))
