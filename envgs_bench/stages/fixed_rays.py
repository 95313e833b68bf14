"""Fixed rays: a finished model sampled along rays that are the same for all seeds, see `FixedRaySamples`.

Camera rays are pixels of the scored views. Reflected rays are those that mirrors of the true scene would send, where
the data know depth, normals and what reflects: a model's own would leave from its own surfaces, elsewhere each.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Scene, View
from envgs_bench.fixed_rays import FixedRaySamples
from envgs_bench.methods.method import Method, Monitor
from envgs_bench.parts import REFLECTIVE

VIEWS = 8  # drawn again for the samples, evenly spaced among the scored ones
PIXELS = 4096  # of all of them together
REFLECTED = 1024  # reflected rays
OFFSET = 1e-3  # a reflected ray starts this far above the surface, × scene radius


def sampled(method: Method, scene: Scene, views: Sequence[View]) -> FixedRaySamples:
    """Samples of a prepared method along rays of `views` of the scene."""
    chosen = views[:: -(-len(views) // VIEWS)]
    depths, normals = [], []
    rays = []  # reflected, their origins and directions
    for view in chosen:
        rendering = method.render(view.camera.to(method.device))
        picked = _some(view.camera.width * view.camera.height, PIXELS // len(chosen))
        depths.append(rendering.depth.cpu().reshape(-1)[picked])
        normals.append(functional.normalize(rendering.normal.cpu().reshape(-1, 3)[picked], dim=-1))
        rays.append(_reflected_rays(view, scene.radius))
    origins, directions = (torch.cat(parts) for parts in zip(*rays, strict=True))
    few = _some(len(origins), REFLECTED)
    reflected = None
    if len(few):
        monitor = method.monitor or Monitor()
        reflected = monitor.reflected(origins[few].to(method.device), directions[few].to(method.device))
    return FixedRaySamples(
        radius=scene.radius,
        depth=torch.cat(depths).numpy(),
        normal=torch.cat(normals).numpy(),
        reflected=None if reflected is None else reflected.cpu().numpy(),
    )


def _reflected_rays(view: View, radius: float) -> tuple[Tensor, Tensor]:
    """Origins and unit directions [N, 3] of the view's rays after its true mirrors; none where those are unknown."""
    mirrors = view.masks.get(REFLECTIVE)
    if mirrors is None or view.normal is None or view.depth is None:
        return torch.zeros(0, 3), torch.zeros(0, 3)
    seen = mirrors & (view.depth > 0) & (view.normal.norm(dim=-1) > 0.5)
    start, ray = (rays[seen] for rays in view.camera.rays())
    normal = view.normal[seen]
    incoming = functional.normalize(ray, dim=-1)
    mirrored = incoming - 2 * (incoming * normal).sum(-1, keepdim=True) * normal
    return start + view.depth[seen][:, None] * ray + OFFSET * radius * normal, mirrored


def _some(count: int, most: int) -> Tensor:
    """Up to `most` of the numbers below `count`, always the same."""
    return torch.randperm(count, generator=torch.Generator().manual_seed(0))[:most]
