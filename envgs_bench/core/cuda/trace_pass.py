"""Tracing: the kernels of one batch of rays, forward and backward."""

from __future__ import annotations

import torch
from torch import Tensor

from ..contract import TraceOptions
from ..differentiable import Gradients, PassOutput, Planes, SetTensors
from ..gaussians import GaussianSet
from .bvh import SurfelBvh
from .launch import Kernels, aligned, blocks_for, kernels
from .layout import CONSTANTS, appearance_floats, color_floats, trace_sum_floats
from .sorting import radix_sort

PACKET, PAGE_ROWS = CONSTANTS["PACKET_RAYS"], CONSTANTS["PAGE_ROWS"]
PAGES_PER_PACKET = 2  # at first
SPARE_PAGES = 64
DRAWING = ("ray_keys.cu", "surfels.cu", "trace_rays.cu")

# Pages that a packet of batches on a device takes: of the latest, or of one shortly before that took more, as a step
# may trace several. A batch gets a quarter more; where that is too little, the backward pass traces once more with
# enough.
_latest_pages: dict[torch.device, float] = {}
FADING = 0.97  # of a larger number than the latest


class TracePass:
    """Draws all that `trace` returns; or, made with `color_alone`, what `trace_color` does, of a set without extras."""

    def __init__(
        self,
        gaussians: GaussianSet,
        origins: Tensor,
        directions: Tensor,
        tree: SurfelBvh,
        options: TraceOptions,
        color_alone: bool = False,
    ) -> None:
        tensors = SetTensors.of(gaussians)
        self.tensors = tensors._replace(quaternions=aligned(tensors.quaternions), scales=aligned(tensors.scales))
        self.origins, self.directions = origins.detach().contiguous(), directions.detach().contiguous()
        self.tree, self.options, self.color_alone = tree, options, color_alone
        self.background = options.background.contiguous()
        self.device, self.rays, self.has_sites = gaussians.device, len(origins), gaussians.has_sites
        self.packets = blocks_for(self.rays, PACKET)
        sh, extras = tensors.sh_rows, tensors.extras.shape[1]
        self.appearance_floats = color_floats(sh) if color_alone else appearance_floats(sh, extras)
        self.sum_floats = trace_sum_floats(sh, extras)

    def _kernels(self, *sources: str, removals: bool = False) -> Kernels:
        sh, extras = self.tensors.sh_rows, self.tensors.extras.shape[1]
        along_ray = int(self.options.sh_along_ray)
        return kernels(sources, self.device, SH_COEFFICIENTS=sh, HAS_SITES=int(self.has_sites), EXTRAS=extras,
                       SH_ALONG_RAY=along_ray, COLOR_ALONE=int(self.color_alone), REMOVALS=int(removals),
                       APPEARANCE_FLOATS=self.appearance_floats, TRACE_SUM_FLOATS=self.sum_floats)  # fmt: skip

    def color(self) -> tuple[Tensor, Tensor]:
        """Color [R, 3] and alpha [R]."""
        launch = self._prepared()
        color = torch.empty(3, self.rays, device=self.device)
        alpha = torch.empty(self.rays, device=self.device)
        left_out = [None] * 9  # from depth to pages_used
        self._draw(launch, color, alpha, *left_out, 0)
        return color.T, alpha

    def forward(self, keep: bool) -> PassOutput:
        launch = self._prepared()
        pages = 0
        if keep:
            pages = int(self.packets * _latest_pages.get(self.device, PAGES_PER_PACKET) * 1.25) + SPARE_PAGES
        drawn = self._trace(launch, pages)
        if keep and not torch.cuda.is_current_stream_capturing():
            self._wanted = torch.empty(1, dtype=torch.int32, pin_memory=True)
            self._wanted.copy_(self.pages_used, non_blocking=True)
            self._counted = torch.cuda.current_stream().record_event()
        return drawn

    def _prepared(self) -> Kernels:
        launch = self._kernels(*DRAWING)
        self.order = self._order(launch)
        self.appearances = self._appearances(launch)
        return launch

    def _order(self, launch: Kernels) -> Tensor:
        keys = torch.empty(self.rays, dtype=torch.int32, device=self.device)
        if self.rays == 0:
            return keys
        launch("ray_keys", blocks_for(self.rays, 256), 256, self.origins, self.directions, self.rays,
               self.tree.statistics, keys)  # fmt: skip
        return radix_sort(keys, None, torch.full((1,), self.rays, dtype=torch.int32, device=self.device), 32)[1]

    def _appearances(self, launch: Kernels) -> Tensor:
        sh, extras, count = self.tensors.sh, self.tensors.extras, self.tree.count
        packed = torch.empty(count, self.appearance_floats, device=self.device)
        launch("pack_appearances", blocks_for(packed.numel(), 256), 256, self.tree.order, sh, extras, count, packed)
        return packed

    def _trace(self, launch: Kernels, pages: int) -> PassOutput:
        tensors = self.tensors
        planes = Planes.empty(tensors.means, self.rays, tensors.extras.shape[1])
        hits = torch.empty(self.rays, dtype=torch.int32, device=self.device)
        weights = torch.zeros_like(tensors.opacities)
        self.page_slots = torch.empty(pages * PAGE_ROWS * PACKET, dtype=torch.int32, device=self.device)
        self.page_next = torch.empty(pages, dtype=torch.int32, device=self.device)
        self.page_heads = torch.empty(2 * self.packets, dtype=torch.int32, device=self.device)
        self.pages_used = torch.zeros(1, dtype=torch.int32, device=self.device)
        self._draw(
            launch, *planes, hits, weights, self.page_slots, self.page_next, self.page_heads, self.pages_used, pages
        )
        self.weights, self.pages = weights, pages
        return PassOutput(planes, hits, weights)

    def _draw(self, launch: Kernels, *results: Tensor | int | None) -> None:
        tree, options = self.tree, self.options
        launch("trace_rays", self.packets, 32, self.origins, self.directions, self.order, self.rays,
               tree.surfels, self.appearances, tree.boxes, tree.count, tree.statistics, float(options.t_min),
               options.transmittance_min, self.background, *results)  # fmt: skip

    def _check_pages(self) -> None:
        self._counted.synchronize()
        used = int(self._wanted)
        _latest_pages[self.device] = max(used / max(self.packets, 1), FADING * _latest_pages.get(self.device, 0.0))
        if used > self.pages:
            self._trace(self._kernels(*DRAWING), used)

    def backward(self, planes: Planes, gradients: tuple[Tensor | None, ...]) -> Gradients:
        if not torch.cuda.is_current_stream_capturing():
            self._check_pages()
        tensors, tree, count = self.tensors, self.tree, self.tree.count
        launch = self._kernels("surfels.cu", "differentiate_rays.cu", removals=self.options.removals)
        sums = tensors.means.new_zeros(count, self.sum_floats)
        g_origins, g_directions = torch.empty_like(self.origins), torch.empty_like(self.directions)
        launch("differentiate_rays", blocks_for(self.rays, 128), 128, self.origins, self.directions, self.order,
               self.rays, tree.surfels, self.appearances, self.background, *planes, *gradients, self.page_slots,
               self.page_next, self.page_heads, self.pages_used, self.pages, sums, g_origins,
               g_directions)  # fmt: skip
        result, position = SetTensors(*map(torch.empty_like, tensors)), torch.empty_like(tensors.means)
        launch("finish_surfels", blocks_for(count, 128), 128, tensors.quaternions, tensors.scales, count, self.weights,
               sums, *result, position)  # fmt: skip
        return Gradients(result, position, g_origins, g_directions)
