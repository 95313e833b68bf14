"""The acceleration structure of the tracer, see bvh.cuh."""

from __future__ import annotations

import torch
from torch import Tensor

from ..differentiable import SetTensors
from .launch import aligned, blocks_for, kernels
from .layout import CONSTANTS
from .sorting import radix_sort

MAX_SURFELS = 1 << 24
LEAF = CONSTANTS["LEAF_SURFELS"]


class SurfelBvh:
    """A tree over one state of a set of surfels.

    Raises:
        ValueError: more than 2²⁴ surfels.
    """

    def __init__(self, tensors: SetTensors) -> None:
        self.count = len(tensors.means)
        if self.count > MAX_SURFELS:
            raise ValueError(f"the CUDA tracer takes at most {MAX_SURFELS:,} surfels, got {self.count:,}")
        device = tensors.means.device
        self._kernels = kernels(("bvh.cu",), device, SH_COEFFICIENTS=1, HAS_SITES=0, EXTRAS=0, COLOR_ALONE=0)
        self.statistics = torch.zeros(CONSTANTS["CENTER_STATISTIC_INTS"], dtype=torch.int32, device=device)
        self.statistics[:3] = -1
        self.levels = level_sizes(self.count)
        self.surfels = torch.empty(LEAF * self.levels[0] * CONSTANTS["SURFEL_FLOATS"], device=device)
        self.boxes = torch.empty(3, sum(self.levels), 2, device=device)
        self.order = self._order(tensors)
        self._pack(tensors)

    def _order(self, tensors: SetTensors) -> Tensor:
        means, opacities, count = tensors.means, tensors.opacities, self.count
        if count == 0:
            return torch.empty(0, dtype=torch.int32, device=means.device)
        launch = self._kernels
        launch("center_statistics", min(blocks_for(count, 1024), 264), 256, means, count, self.statistics)
        keys = torch.empty(count, dtype=torch.int32, device=means.device)
        launch("hilbert_keys", blocks_for(count, 256), 256, means, opacities, count, self.statistics, keys)
        whole = torch.full((1,), count, dtype=torch.int32, device=means.device)
        return radix_sort(keys, None, whole, 32)[1]

    def _pack(self, tensors: SetTensors) -> None:
        launch, count = self._kernels, self.count
        threads = 32 * LEAF * (self.levels[1] if len(self.levels) > 1 else 1)
        launch("pack_surfels", blocks_for(threads, 256), 256, tensors.means, aligned(tensors.quaternions),
               aligned(tensors.scales), tensors.opacities, count, self.order, self.surfels, self.boxes)  # fmt: skip
        for level in range(1, len(self.levels) - 1):
            threads = 32 * self.levels[level + 1]
            launch("merge_boxes", blocks_for(threads, 256), 256, self.boxes, count, level)


def level_sizes(count: int) -> list[int]:
    """Boxes of each level, the leaves' first: whole groups of 32, one group at the top."""
    groups = max(blocks_for(count, 32 * LEAF), 1)
    sizes = [32 * groups]
    while groups > 1:
        groups = blocks_for(groups, 32)
        sizes.append(32 * groups)
    return sizes
