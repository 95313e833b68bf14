"""Tile lists: how many primitives the rasterizer finds in each tile of a picture, which is where scenes differ most."""

from __future__ import annotations

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet
from envgs_bench.core.contract import RasterizeOptions


def tile_list_lengths(gaussians: GaussianSet, camera: Camera, near: float, backend: str) -> Tensor:
    """[tiles] int32, row by row: the length of each tile's list in `rasterize` with these arguments.

    Args:
        backend: "cpu" or "cuda". Both list a primitive in the tiles that its outline touches.
    """
    black = torch.zeros(3, device=gaussians.device)
    options = RasterizeOptions(background=black, near=near, low_pass=True, transmittance_min=1e-4)
    if backend == "cpu":
        from envgs_bench.core.cpu import RasterPass as CpuPass

        on_cpu = CpuPass(gaussians, camera, options)
        on_cpu.forward(keep=False)
        return on_cpu.list_lengths()
    from envgs_bench.core.cuda.raster_pass import RasterPass

    drawn = RasterPass(gaussians, camera, options)
    drawn.forward(keep=False)
    first, end = drawn.ranges.reshape(-1, 2).unbind(1)
    return end - first
