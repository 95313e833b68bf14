"""Rasterizing: the kernels of one image, forward and backward."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import torch
from torch import Tensor

from ..camera import Camera
from ..contract import RasterizeOptions
from ..differentiable import Gradients, PassOutput, Planes, SetTensors
from ..gaussians import GaussianSet
from .launch import Kernels, aligned, blocks_for, kernels, zeroed
from .layout import CONSTANTS, visible_floats
from .sorting import radix_sort

TILE = CONSTANTS["TILE"]
FEW_TILES = 7  # for each multiprocessor: an image of fewer shares each of a tile's areas between a block's warps
SHARED_IN_PAIRS = 1  # tiles for each multiprocessor from which a thread takes two pixels of an area that is shared
IN_PAIRS = 25  # and of one that is not
MIN_CAPACITY = 1 << 20
BYTES_PER_INSTANCE = 24  # keys and slots, before and after a sorting pass

# How many instances images on a device have: those of the latest, or of one shortly before that had more, as a step
# may draw several sets. An image gets half as much capacity again, without waiting for its own count; where that is too
# little, it is drawn again with enough.
_latest_instances: dict[torch.device, int] = {}
FADING = 0.97  # of a larger number than the latest


class RasterPass:
    """Draws all that `rasterize` returns; or, made with `color_alone`, what `rasterize_color` does, without extras."""

    def __init__(
        self, gaussians: GaussianSet, camera: Camera, options: RasterizeOptions, color_alone: bool = False
    ) -> None:
        tensors = SetTensors.of(gaussians)
        self.tensors = tensors._replace(quaternions=aligned(tensors.quaternions))
        self.camera, self.options, self.color_alone = camera, options, color_alone
        self.background = options.background.contiguous()
        self.device, self.has_sites = gaussians.device, gaussians.has_sites
        self.visible_floats = visible_floats(tensors.scales.shape[1], tensors.extras.shape[1], color_alone)
        self.tiles_x, self.tiles_y = blocks_for(camera.width, TILE), blocks_for(camera.height, TILE)
        self.pixels, shares = _sharing(self.tiles_x * self.tiles_y, self.device)
        areas = TILE**2 // (32 * self.pixels)  # of a tile, a warp's each
        self.tile_blocks = areas if shares else 1
        self.threads = 32 * (CONSTANTS["SHARING_WARPS"] if shares else areas)

    def _kernels(self, *sources: str, removals: bool = False) -> Kernels:
        kind = "SurfelKind" if self.tensors.scales.shape[1] == 2 else "Gaussian3dKind"
        sh, extras = self.tensors.sh_rows, self.tensors.extras.shape[1]
        return kernels(sources, self.device, KIND=kind, SH_COEFFICIENTS=sh, HAS_SITES=int(self.has_sites),
                       EXTRAS=extras, COLOR_ALONE=int(self.color_alone), REMOVALS=int(removals),
                       VISIBLE_FLOATS=self.visible_floats, TILE_BLOCKS=self.tile_blocks,
                       THREAD_PIXELS=self.pixels)  # fmt: skip

    def color(self) -> tuple[Tensor, Tensor]:
        """Color [P, 3] and alpha [P]."""
        pixels = self.camera.width * self.camera.height
        color, alpha = self.tensors.means.new_empty(3, pixels), self.tensors.means.new_empty(pixels)
        left_out = [None] * 4  # from depth to hits
        self._draw((color, alpha, *left_out), None)
        return color.T, alpha

    def forward(self, keep: bool) -> PassOutput:
        planes = Planes.empty(self.tensors.means, self.camera.width * self.camera.height, self.tensors.extras.shape[1])
        hits = planes.alpha.new_empty(planes.alpha.shape, dtype=torch.int32)
        weights = torch.empty_like(self.tensors.opacities)
        self._draw((*planes, hits), weights)
        return PassOutput(planes, hits, weights)

    def _draw(self, results: Sequence[Tensor | None], weights: Tensor | None) -> None:
        count = len(self.tensors.means)
        launch = self._kernels("camera.cu", "primitives.cu", "tile_instances.cu", "draw_tiles.cu")
        self._prepare(launch, weights)
        order = radix_sort(self.depth_keys, None, self.counters[:1], 32)[1] if count else self.depth_keys
        capturing = torch.cuda.is_current_stream_capturing()
        if not capturing:
            wanted = torch.empty(CONSTANTS["COUNTER_INTS"], dtype=torch.int32, pin_memory=True)
            wanted.copy_(self.counters, non_blocking=True)
            counted = torch.cuda.current_stream().record_event()
        capacity = max(_latest_instances.get(self.device, 4 * count) * 3 // 2, MIN_CAPACITY)
        self._draw_instances(launch, order, capacity, results, weights)
        if not capturing:
            counted.synchronize()  # the drawing is still under way
            instances = int(wanted[2:].view(torch.int64))
            if instances > capacity:
                _check_memory(instances, self.device)
                if weights is not None:
                    weights.zero_()
                self._draw_instances(launch, order, instances, results, weights)
            _latest_instances[self.device] = max(instances, int(FADING * _latest_instances.get(self.device, 0)))

    def _prepare(self, launch: Kernels, weights: Tensor | None) -> None:
        tensors, count = self.tensors, len(self.tensors.means)
        blocks = blocks_for(count, 256)
        empty = tensors.means.new_empty
        self.visible, self.outlines = empty(count, self.visible_floats), empty(count, CONSTANTS["OUTLINE_FLOATS"])
        self.device_camera = make_camera(launch, self.camera, self.options)
        self.depth_keys, self.tile_counts = (empty(count, dtype=torch.int32) for _ in range(2))
        self.slots, self.indices = (None if self.color_alone else empty(count, dtype=torch.int32) for _ in range(2))
        self.counters, state, ticket = zeroed(self.device, CONSTANTS["COUNTER_INTS"], 2 * blocks, 1)
        launch("prepare_primitives", blocks, 256, *tensors, count, self.device_camera, self.visible, self.outlines,
               self.depth_keys, self.tile_counts, self.slots, self.indices, weights, self.counters, state,
               ticket)  # fmt: skip

    def _draw_instances(
        self, launch: Kernels, order: Tensor, capacity: int, results: Sequence[Tensor | None], weights: Tensor | None
    ) -> None:
        count, tiles = len(self.tensors.means), self.tiles_x * self.tiles_y
        blocks = blocks_for(count, 256)
        state, ticket, self.ranges = zeroed(self.device, 2 * blocks, 1, 2 * tiles)
        keys, slots = (torch.empty(capacity, dtype=torch.int32, device=self.device) for _ in range(2))
        launch("emit_instances", blocks, 256, order, self.outlines, self.tile_counts, self.counters, capacity,
               self.tiles_x, keys, slots, state, ticket)  # fmt: skip
        keys, self.instance_slots = radix_sort(keys, slots, self.counters[1:2], max((tiles - 1).bit_length(), 1))
        launch("find_tile_ranges", blocks_for(capacity, 256), 256, keys, self.counters, self.ranges)
        blocks = self.tile_blocks * tiles
        launch("draw_tiles", blocks, self.threads, self.ranges, self.instance_slots, self.visible, self.outlines,
               self.device_camera, self.tiles_x, float(self.options.transmittance_min), self.background, self.counters,
               *results, self.indices, weights)  # fmt: skip

    def backward(self, planes: Planes, gradients: tuple[Tensor | None, ...]) -> Gradients:
        tensors, count = self.tensors, len(self.tensors.means)
        launch = self._kernels("primitives.cu", "differentiate_tiles.cu", removals=self.options.removals)
        sums = tensors.means.new_zeros(count, CONSTANTS["PRIMITIVE_SUM_FLOATS"])
        blocks = self.tile_blocks * self.tiles_x * self.tiles_y
        launch("differentiate_tiles", blocks, self.threads, self.ranges, self.instance_slots, self.visible,
               self.outlines, self.device_camera, self.tiles_x, float(self.options.transmittance_min),
               self.background, *planes, *gradients, sums)  # fmt: skip
        result, position = SetTensors(*map(torch.empty_like, tensors)), torch.empty_like(tensors.means)
        launch("finish_primitives", blocks_for(count, 128), 128, *tensors, count, self.device_camera, self.visible,
               self.slots, sums, *result, position)  # fmt: skip
        return Gradients(result, position)


def _sharing(tiles: int, device: torch.device) -> tuple[int, bool]:
    """How an image of so many tiles is drawn: a thread's pixels, and whether a block's warps share an area.

    Two pixels cost a thread less than twice as much as one, where there are enough of them to fill the GPU.
    """
    each = tiles / _multiprocessors(device)
    shares = each < FEW_TILES
    return (2 if each >= (SHARED_IN_PAIRS if shares else IN_PAIRS) else 1), shares


@cache
def _multiprocessors(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).multi_processor_count


def make_camera(launch: Kernels, camera: Camera, options: RasterizeOptions | None = None) -> Tensor:
    """The camera as kernels see it, made on the device by camera.cu, which `launch` must include.

    Without options it is one that rays and normals are taken from, not one that draws.
    """
    how = (float(options.near), options.low_pass, options.low_pass_statistics) if options else (0.0, False, False)
    view = torch.empty(CONSTANTS["CAMERA_FLOATS"], device=camera.device)
    launch("make_camera", 1, 1, camera.world_to_camera.contiguous(), camera.intrinsics.contiguous(), camera.width,
           camera.height, *how, view)  # fmt: skip
    return view


def _check_memory(instances: int, device: torch.device) -> None:
    """Raise before an allocation would: primitives that cover all tiles can ask for any amount of memory."""
    free = torch.cuda.mem_get_info(device)[0]
    free += torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    needed = instances * BYTES_PER_INSTANCE
    if instances >= 2**31 or needed > free:
        raise torch.OutOfMemoryError(
            f"this image has {instances:,} pairs of a primitive and a tile that it covers, which takes "
            f"{needed / 2**30:.1f} GiB; {free / 2**30:.1f} GiB are free. Draw fewer or smaller primitives, or a "
            "smaller image"
        )
