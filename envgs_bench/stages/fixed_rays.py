"""Fixed rays: a finished model sampled along rays that are the same for all seeds, see `FixedRaySamples`.

Camera rays are pixels of the scored views. Reflected rays are those that mirrors of the true scene would send, where
the data know depth, normals and what reflects: a model's own would leave from its own surfaces, elsewhere each.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Rendering, View
from envgs_bench.fixed_rays import FixedRaySamples
from envgs_bench.methods.method import Method, Monitor
from envgs_bench.parts import REFLECTIVE

VIEWS = 8  # at most, evenly spaced among the scored ones
PIXELS = 4096  # of all of them together
REFLECTED = 1024  # reflected rays
OFFSET = 1e-3  # a reflected ray starts this far above the surface, × scene radius


class FixedRays:
    """Takes its samples of camera rays from the renderings that are scored, as they are drawn."""

    def __init__(self, views: Sequence[View]) -> None:
        self._chosen = views[:: -(-len(views) // VIEWS)]
        self._seen: dict[str, tuple[Tensor, Tensor]] = {}  # view -> depths [N], unit normals [N, 3]

    def see(self, view: View, rendering: Rendering) -> None:
        """Sample this rendering, if its view is one of those that are sampled."""
        if all(view is not chosen for chosen in self._chosen):
            return
        picked = _some(view.camera.width * view.camera.height, PIXELS // len(self._chosen))
        normals = rendering.normal.cpu().reshape(-1, 3)[picked]
        self._seen[view.name] = rendering.depth.cpu().reshape(-1)[picked], functional.normalize(normals, dim=-1)

    def samples(self, method: Method, radius: float) -> FixedRaySamples:
        """What was seen of all views, and what the prepared method shows along reflected rays.

        Args:
            radius: the scene's, world units.
        """
        depths, normals = zip(*(self._seen[view.name] for view in self._chosen), strict=True)
        rays = [_reflected_rays(view, radius) for view in self._chosen]
        origins, directions = (torch.cat(parts) for parts in zip(*rays, strict=True))
        few = _some(len(origins), REFLECTED)
        reflected = None
        if len(few):
            monitor = method.monitor or Monitor()
            reflected = monitor.reflected(origins[few].to(method.device), directions[few].to(method.device))
        return FixedRaySamples(
            radius=radius,
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
