"""`envgs-bench bench tracers`: three ways to draw a frame of reflected rays (EnvGS paper, Table 6)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, available_backends, build_bvh, rasterize, trace

from .arguments import positive, size
from .repeats import time_work
from .room import reflected_rays, room_gaussians

DESCRIPTION = """\
Time one frame of reflected rays through a room of surfels, without gradients: by the tracer; by testing every ray
against every surfel in PyTorch; and by rasterizing a picture of one pixel for each ray. The slow ways draw a sample of
the frame's rays, evenly spread, and their time is scaled to all of them. The first two draw the same colors; a
rasterizer blends in the order of centers, not of hits, and so differs where surfels overlap.
"""
WAYS = ("tracer", "PyTorch", "1×1 rasterizer")
NEAR = 1e-3  # world units: rays start 0.02 off their surface
SECONDS_PER_WAY = 60.0

Draw = Callable[[Tensor, Tensor], Tensor]  # origins and directions [R, 3] to colors [R, 3]


def main(arguments: Sequence[str] | None = None) -> int:
    """Time the ways and print them; the exit status."""
    options = _parser().parse_args(arguments)
    reason = available_backends()[options.backend]
    if reason is not None:
        print(f"envgs-bench bench tracers: backend {options.backend!r} does not work here: {reason}", file=sys.stderr)
        return 1
    table = Table(title=f"{options.primitives:,} surfels, {options.size[0]}×{options.size[1]}, {options.backend}")
    for name in ("way", "seconds a frame", "frames a second", "rays timed", "mean color difference"):
        table.add_column(name, justify="left" if name == "way" else "right")
    for row in compare(options.primitives, options.size, options.backend, options.rays):
        seconds = row["seconds"]
        rate = f"{1 / seconds:.1f}" if seconds < 1 else f"1/{seconds:,.1f}"
        table.add_row(row["way"], f"{seconds:,.3f}", rate, f"{row['rays']:,}", f"{row['difference']:.1e}")
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    return 0


@torch.no_grad()
def compare(primitives: int, frame: tuple[int, int], backend: str, rays: int) -> list[dict]:
    """Seconds that each of `WAYS` takes for a frame (width, height), and its mean distance from the tracer's colors.

    Args:
        backend: the tracer's and the rasterizer's, "cpu" or "cuda"; PyTorch works on the same device.
        rays: how many of the frame's rays the slow ways draw.
    """
    device = torch.device("cuda" if backend == "cuda" else "cpu")
    gaussians = room_gaussians(primitives).to(device)
    origins, directions = (x.reshape(-1, 3).to(device) for x in reflected_rays(*frame))
    chosen = torch.linspace(0, len(origins) - 1, min(rays, len(origins))).long()
    sample = origins[chosen], directions[chosen]
    draws = _draws(gaussians, backend)
    expected = draws["tracer"](*sample)
    rows = []
    for way in WAYS:
        drawn = (origins, directions) if way == "tracer" else sample
        times = time_work(partial(draws[way], *drawn), device, 20, SECONDS_PER_WAY)
        seconds = times.median_ms / 1000 * len(origins) / len(drawn[0])
        difference = float((draws[way](*sample) - expected).abs().mean())
        rows.append({"way": way, "seconds": seconds, "rays": len(drawn[0]), "difference": difference})
    return rows


def _draws(gaussians: GaussianSet, backend: str) -> dict[str, Draw]:
    bvh = build_bvh(gaussians, backend=backend)

    def one_pixel_each(origins: Tensor, directions: Tensor) -> Tensor:
        cameras = [pixel_along(o, d) for o, d in zip(origins.cpu(), directions.cpu(), strict=True)]
        drawn = [
            rasterize(gaussians, camera.to(origins.device), near=NEAR, low_pass=False, backend=backend).color[0]
            for camera in cameras
        ]
        return torch.cat(drawn)

    return {
        "tracer": lambda o, d: trace(gaussians, o, d, t_min=NEAR, bvh=bvh, backend=backend).color,
        "PyTorch": lambda o, d: trace(gaussians, o, d, t_min=NEAR, backend="torch").color,
        "1×1 rasterizer": one_pixel_each,
    }


def pixel_along(origin: Tensor, direction: Tensor) -> Camera:
    """The camera of one pixel whose ray starts at `origin` [3] and goes along the unit `direction` [3]."""
    helper = torch.eye(3)[direction.abs().argmin()]
    right = torch.nn.functional.normalize(torch.linalg.cross(helper, direction), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(direction, right), direction])
    pose[:3, 3] = -pose[:3, :3] @ origin
    return Camera(pose, torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]), 1, 1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="envgs-bench bench tracers", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--primitives", type=positive, default=300_000, metavar="N", help="surfels (default: 300,000)")
    parser.add_argument("--size", type=size, default=(876, 584), metavar="WxH", help="frame size (default: 876x584)")
    parser.add_argument("--backend", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    parser.add_argument("--rays", type=positive, default=64, metavar="N", help="rays of the sample (default: 64)")
    return parser
