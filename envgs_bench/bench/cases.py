"""What is timed: the cases of a benchmark of the core, and how one is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product

import torch
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering, build_bvh, rasterize, trace

from .frame import envgs_work
from .peers import PEERS, PeerImage, peer_drawing
from .repeats import time_work
from .room import reflected_rays, room_camera, room_gaussians

Size = tuple[int, int]
Drawn = Rendering | PeerImage

DIRECTIONS = ("forward", "forward_backward")
DEFAULT_SIZES: dict[str, list[Size]] = {
    "trace": [(160, 120)],
    "rasterize_2d": [(640, 480)],
    "rasterize_3d": [(640, 480)],
}
DEFAULT_PRIMITIVES = {
    "trace": [2_000, 20_000, 300_000],
    "rasterize_2d": [20_000],
    "rasterize_3d": [20_000],
    "build": [20_000, 300_000],
}
ORACLE_SIZES: list[Size] = [(40, 30)]  # where the torch oracle and a native backend are timed side by side
ORACLE_PRIMITIVES = [20_000]
GPU_SIZES: list[Size] = [(1292, 839)]  # what the tracer's targets are stated for
GPU_PRIMITIVES = [300_000, 2_000_000]
GPU_ENVGS_PRIMITIVES = 300_000  # the environment's
OWN_SIZES = {"torch": ORACLE_SIZES, "embree": ORACLE_SIZES, "cuda": GPU_SIZES}
OWN_PRIMITIVES = {"torch": ORACLE_PRIMITIVES, "embree": ORACLE_PRIMITIVES, "cuda": GPU_PRIMITIVES}
SWEEP_PRIMITIVES = [2_000, 6_000, 20_000, 60_000, 300_000]
SWEEP_SIZES: list[Size] = [(80, 60), (160, 120), (320, 240), (640, 480)]
SECONDS_PER_CASE = 10.0


@dataclass(frozen=True)
class Case:
    op: str  # trace, rasterize_2d, rasterize_3d, build, envgs
    direction: str  # forward, forward_backward; of envgs: an image, a training step
    backend: str
    primitives: int
    width: int | None  # None where no image is drawn
    height: int | None


def chosen_cases(backends: Sequence[str], primitives: Sequence[int] | None, sizes: Sequence[Size] | None) -> list[Case]:
    """All operations at all given numbers of primitives and sizes; defaults for each operation where None.

    By default the torch oracle is timed on a small picture, and the native backends on the same one beside their own.
    """
    cases = []
    for backend in backends:
        cases += _cases(backend, primitives or OWN_PRIMITIVES.get(backend), sizes or OWN_SIZES.get(backend))
        if backend == "cuda" and not primitives and not sizes:
            cases += [Case("envgs", each, backend, GPU_ENVGS_PRIMITIVES, *GPU_SIZES[0]) for each in DIRECTIONS]
        if "torch" in backends and backend in ("cpu", "cuda") and not sizes:
            cases += [c for c in _cases(backend, primitives or ORACLE_PRIMITIVES, ORACLE_SIZES) if c.op != "build"]
    return cases


def peer_cases(cases: Sequence[Case]) -> list[Case]:
    """What the peers can be asked for of the GPU's cases."""
    drawn = [case for case in cases if case.backend == "cuda" and case.op in ("rasterize_2d", "rasterize_3d")]
    return [replace(case, backend=peer) for peer in PEERS for case in drawn]


def sweep_cases(backends: Sequence[str]) -> list[Case]:
    """The cases of a chart: primitives at the default sizes, then sizes at 20,000 primitives."""
    cases = []
    for backend in backends:
        cases += _cases(backend, SWEEP_PRIMITIVES, None)
        cases += [case for case in _cases(backend, [20_000], SWEEP_SIZES) if case.op != "build"]
    return list(dict.fromkeys(cases))


def _cases(backend: str, primitives: Sequence[int] | None, sizes: Sequence[Size] | None) -> list[Case]:
    ops = {"embree": ["trace"], "torch": ["trace", "rasterize_2d", "rasterize_3d"]}
    cases = []
    for op in ops.get(backend, ["trace", "rasterize_2d", "rasterize_3d", "build"]):
        counts = primitives or DEFAULT_PRIMITIVES[op]
        if op == "build":
            cases += [Case(op, "forward", backend, count, None, None) for count in counts]
        else:
            each = product(counts, sizes or DEFAULT_SIZES[op], DIRECTIONS)
            cases += [Case(op, direction, backend, count, *size) for count, size, direction in each]
    return cases


def time_case(case: Case, repeats: int) -> dict[str, object]:
    """Time one case; the row of the result: the case's own fields, median and quartile distance in ms, hits a ray and
    their mean alpha, and on a GPU the peak of allocated memory, which includes the inputs.
    """
    device = torch.device("cuda" if case.backend in ("cuda", *PEERS) else "cpu")
    work, hits, alpha = _work(case, device)
    peak_bytes = None
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
    times = time_work(work, device, repeats, SECONDS_PER_CASE)
    if device.type == "cuda":
        peak_bytes = torch.cuda.max_memory_allocated()
    timed = {"median_ms": times.median_ms, "spread_ms": times.spread_ms, "repeats": len(times.all_ms)}
    return asdict(case) | timed | {"hits_per_ray": hits, "alpha": alpha, "peak_bytes": peak_bytes}


def _work(case: Case, device: torch.device) -> tuple[Callable[[], object], float | None, float | None]:
    """What is timed, hits a ray and mean alpha; None where there are none."""
    if case.op == "envgs":
        assert case.width is not None
        assert case.height is not None
        image, step = envgs_work(case.primitives, case.width, case.height, backend=case.backend, device=device)
        rendering = image()
        return image if case.direction == "forward" else step, None, float(rendering.alpha.double().mean())
    columns = 3 if case.op == "rasterize_3d" else 2
    gaussians = room_gaussians(case.primitives, columns=columns).to(device)
    if case.op == "build":
        return partial(build_bvh, gaussians, backend=case.backend), None, None
    draw, inputs = _drawing(case, gaussians, device)
    with torch.no_grad():
        drawn = draw()
    work = without_gradients(draw) if case.direction == "forward" else with_gradients(draw, inputs, drawn)
    hits = None if drawn.hits is None else float(drawn.hits.double().mean())
    return work, hits, float(drawn.alpha.double().mean())


def _drawing(case: Case, gaussians: GaussianSet, device: torch.device) -> tuple[Callable[[], Drawn], list[Tensor]]:
    """What draws the case's image or rays (the BVH is built outside of it), and everything it is differentiable in."""
    assert case.width is not None
    assert case.height is not None
    leaves = gaussians.map(lambda x: x.requires_grad_())
    inputs = [value for value in vars(leaves).values() if value is not None]
    if case.op == "trace":
        rays = [x.to(device).requires_grad_() for x in reflected_rays(case.width, case.height)]
        bvh = build_bvh(leaves, backend=case.backend)
        return lambda: trace(leaves, *rays, bvh=bvh, backend=case.backend), [*inputs, *rays]
    camera = room_camera(case.width, case.height).to(device)
    if case.backend in PEERS:
        return peer_drawing(leaves, camera), inputs
    return lambda: rasterize(leaves, camera, backend=case.backend), inputs


def without_gradients(draw: Callable[[], Drawn]) -> Callable[[], object]:
    def work() -> object:
        with torch.no_grad():
            return draw()

    return work


def with_gradients(draw: Callable[[], Drawn], inputs: list[Tensor], drawn: Drawn) -> Callable[[], object]:
    """Draw, and differentiate a random combination of all that is drawn in all that it depends on."""
    names = [name for name in ("color", "alpha", "depth", "normal") if getattr(drawn, name) is not None]
    generator = torch.Generator().manual_seed(0)
    upstream = [torch.randn(getattr(drawn, name).shape, generator=generator).to(drawn.color) for name in names]

    def work() -> object:
        rendering = draw()
        return torch.autograd.grad([getattr(rendering, name) for name in names], inputs, upstream)

    return work
