"""One EnvGS image and one training step in the room: its passes, and all that lies between them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import normalize

from envgs_bench.core import Rendering, View
from envgs_bench.methods.envgs import EnvGS, EnvGSSettings
from envgs_bench.methods.schedule import Schedule
from envgs_bench.parts import BASE, ENV

from .room import EYE, TARGET, room_camera, room_gaussians

BASE_SHARE = 5  # base surfels for each of the environment's, as in the paper's scenes
BETA = 0.5  # every pixel reflects
STEP = 10_001  # one of 30,000 that traces, and neither densifies nor resets


def envgs_work(
    primitives: int, width: int, height: int, *, backend: str, device: torch.device
) -> tuple[Callable[[], Rendering], Callable[[], object]]:
    """An EnvGS model with `primitives` environment surfels and five times as many base surfels, all in the room.

    Returns:
        What renders its image (activated parameters and the BVH are kept between images, as between a viewer's), and
        what trains it by a step on a random image, losses and Adam included.
    """
    method = EnvGS(EnvGSSettings(backend=backend), device)
    sets = {BASE: _parameters(BASE_SHARE * primitives, BETA), ENV: _parameters(primitives, None)}
    state = {
        "sets": {name: {field: x.to(device) for field, x in tensors.items()} for name, tensors in sets.items()},
        "radius": float((EYE - TARGET).norm()),
        "near": method.near,
        "background": torch.zeros(3, device=device),
        "reflects": True,
    }
    method.restore(state)
    method.schedule = Schedule(30_000)
    camera = room_camera(width, height).to(device)
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(0, 256, (height, width, 3), generator=generator, dtype=torch.uint8).to(device)
    normal = normalize(torch.randn(height, width, 3, generator=generator), dim=-1).to(device)
    view = View("room", camera, image, normal=normal)
    return lambda: method.render(camera), lambda: method.training_step(view, STEP)


def _parameters(count: int, beta: float | None) -> dict[str, Tensor]:
    """The room's surfels as what Adam moves, see GaussianParameters."""
    room = room_gaussians(count)
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
