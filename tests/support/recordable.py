"""What a recorded training step may not do, found without a GPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

WAITING = {
    "aten::_local_scalar_dense": "reads a number",
    "aten::nonzero": "makes a size of values",
    "aten::masked_select": "makes a size of values",
    "aten::lift_fresh": "copies numbers to the device",
}


class WaitsForTheDevice(TorchDispatchMode):
    """Within it, `found` collects operations for which the host would wait for a GPU, by what they do."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        name = function._schema.name
        if name in WAITING:
            self.found.append(f"{name} {WAITING[name]}")
        indices = arguments[1] if name in ("aten::index", "aten::index_put", "aten::index_put_") else ()
        if any(isinstance(index, Tensor) and index.dtype == torch.bool for index in indices):
            self.found.append(f"{name} by a mask makes a size of values")
        return function(*arguments, **(named or {}))
