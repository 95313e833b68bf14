"""Exposure: each training view's own exposure and color, learned along with the scene.

A camera chooses an exposure and a white balance for each photograph, which shows the scene's colors c as A c + b, with
A [3, 3] and b [3] of the view. They start as the identity and are held to it, so that the scene itself, which test
pictures show, keeps the views' common exposure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from .optimizer import adam, optimizer_state, restore_optimizer
from .schedule import Part

RATE = 1e-3  # of Adam
WEIGHT = 0.01  # of the squared difference to the identity, the mean over a view's twelve numbers


class AffineExposure(Part):
    """An affine map of color for each of the views named.

    Attributes:
        maps: [V, 3, 4], A beside b.
        optimizer: of the maps.
    """

    def __init__(self, views: Sequence[str], device: torch.device) -> None:
        self._rows = {name: row for row, name in enumerate(views)}
        self._identity = torch.eye(3, 4, device=device)
        self.maps = self._identity.repeat(len(views), 1, 1).requires_grad_()
        self.optimizer = adam([{"params": [self.maps], "lr": RATE, "name": "exposure"}])

    def applied(self, view: str, color: Tensor) -> Tensor:
        """The scene's colors [H, W, 3] as the view's camera shows them."""
        own = self.maps[self._rows[view]]
        return color @ own[:, :3].T + own[:, 3]

    def loss(self, view: str) -> Tensor:
        """What holds the view's map to the identity, a scalar."""
        return WEIGHT * (self.maps[self._rows[view]] - self._identity).square().mean()

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return (self.optimizer,)

    def training_state(self) -> dict[str, Any]:
        maps = self.maps.detach()
        return {"maps": maps, "moments": optimizer_state(self.optimizer, {"exposure": self.maps})}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        with torch.no_grad():
            self.maps.copy_(state["maps"])
        restore_optimizer(self.optimizer, {"exposure": self.maps}, state["moments"])
