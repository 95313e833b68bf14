"""What a recorded step or picture may not do, found without a GPU; and small scenes to record."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from envgs_bench.core import Camera, Scene, View

WAITING = {
    "aten::_local_scalar_dense": "reads a number",
    "aten::nonzero": "makes a size of values",
    "aten::masked_select": "makes a size of values",
    "aten::lift_fresh": "copies numbers to the device",
}


class WaitsForTheDevice(TorchDispatchMode):
    """Within it, `found` collects operations for which the host would wait for a GPU, by what they do.

    Cameras made within are not checked, as none is on a GPU.
    """

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._unchecked = patch.object(Camera, "__post_init__", lambda camera: None)

    def __enter__(self) -> WaitsForTheDevice:
        self._unchecked.start()
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._unchecked.stop()

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        name = function._schema.name
        if name in WAITING:
            self.found.append(f"{name} {WAITING[name]}")
        indices = arguments[1] if name in ("aten::index", "aten::index_put", "aten::index_put_") else ()
        if any(isinstance(index, Tensor) and index.dtype == torch.bool for index in indices):
            self.found.append(f"{name} by a mask makes a size of values")
        return function(*arguments, **(named or {}))


def pinhole(width: int = 4, height: int = 4) -> Camera:
    return Camera(torch.eye(4), torch.tensor([[4.0, 0, 2], [0, 4, 2], [0, 0, 1]]), width, height)


def points_scene(width: int = 16, height: int = 12) -> Scene:
    """Four views of points before a camera that moves to the side."""
    generator = torch.Generator().manual_seed(5)
    views = []
    for k in range(4):
        pose = torch.eye(4)
        pose[0, 3] = 0.2 * k
        intrinsics = torch.tensor([[float(width), 0, width / 2], [0, width, height / 2], [0, 0, 1]])
        image = torch.randint(0, 256, (height, width, 3), generator=generator, dtype=torch.uint8)
        normal = torch.tensor([0.0, 0, -1]).expand(height, width, 3).clone()
        views.append(View(f"view{k}", Camera(pose, intrinsics, width, height), image, normal=normal))
    points = torch.rand(200, 3, generator=generator) * torch.tensor([3.0, 2.0, 0.5]) + torch.tensor([-1.5, -1, 2.5])
    return Scene("points", views, views[:1], points, torch.rand(200, 3, generator=generator))
