"""Cases: which operations are timed, on what and how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

Size = tuple[int, int]

DIRECTIONS = ("forward", "forward_backward")
RASTERIZED = ("rasterize_2d", "rasterize_3d")
PICTURED = ("rasterize_2d_color", "rasterize_3d_color")
PEERS = {"gsplat": RASTERIZED, "higs": PICTURED[1:]}  # and what they can be asked for
DRAWN = ("trace", *RASTERIZED)
LOOKUPS = ("cubemap", "prefiltered")
METHODS = ("2dgs", "3dgs", "envmap", "envgs")  # forward: an image; forward_backward: a training step
OPERATIONS = ("trace", "trace_color", *RASTERIZED, *PICTURED, "build", "adam", "ssim", *LOOKUPS, *METHODS)
OF_GPUS = ("trace_color", *PICTURED)
WITHOUT_SET = ("ssim", *LOOKUPS)
WITHOUT_PICTURE = ("build", "adam")
WITHOUT_GRADIENTS = (*WITHOUT_PICTURE, "trace_color", *PICTURED)
OF_THE_CORE = (*DRAWN, "build")  # what is timed where sizes are given and no operation is named
OFFERED = {  # by each backend
    "torch": DRAWN,
    "embree": ("trace",),
    "cpu": tuple(op for op in OPERATIONS if op not in OF_GPUS),
    "cuda": OPERATIONS,
}
DEFAULTS = OFFERED | {"cpu": tuple(op for op in OFFERED["cpu"] if op not in METHODS)}  # the others take seconds a call

DEFAULT_SIZES: dict[str, list[Size]] = {
    "rasterize_2d": [(640, 480)],
    "rasterize_3d": [(640, 480)],
    "ssim": [(640, 480)],
}
OTHER_SIZES: list[Size] = [(160, 120)]
DEFAULT_PRIMITIVES = {
    "trace": [2_000, 20_000, 300_000],
    "build": [20_000, 300_000],
    "adam": [20_000, 300_000],
}
OTHER_PRIMITIVES = [20_000]
ORACLE_SIZES: list[Size] = [(40, 30)]  # where the torch oracle and a native backend are timed side by side
ORACLE_PRIMITIVES = [20_000]
GPU_SIZES: list[Size] = [(1292, 839)]  # what the tracer's targets are stated for
GPU_PRIMITIVES = [300_000, 2_000_000]
GPU_METHOD_PRIMITIVES = {"envgs": [300_000]}  # the environment's, beside 1.5 million of the base
GPU_OTHER_METHOD_PRIMITIVES = [1_500_000]
OWN_SIZES = {"torch": ORACLE_SIZES, "embree": ORACLE_SIZES, "cuda": GPU_SIZES}
SWEEP_PRIMITIVES = [2_000, 6_000, 20_000, 60_000, 300_000]
SWEEP_SIZES: list[Size] = [(80, 60), (160, 120), (320, 240), (640, 480)]
ROOM = "room"


@dataclass(frozen=True)
class Case:
    op: str  # one of OPERATIONS; of a trained run also its method's name
    direction: str  # forward, forward_backward; of a method: an image, a training step
    backend: str
    primitives: int  # of envgs in the room the environment's, which a run's counts with the base's; 0: needs none
    width: int | None  # None where no image is drawn
    height: int | None
    scene: str = ROOM  # or the trained run


def chosen_cases(
    backends: Sequence[str],
    primitives: Sequence[int] | None,
    sizes: Sequence[Size] | None,
    operations: Sequence[str] | None = None,
) -> list[Case]:
    """The operations at all given numbers of primitives and sizes; defaults for each operation where None.

    By default the torch oracle is timed on a small picture, and the native backends on the same one beside their own.
    """
    cases = []
    for backend in backends:
        wanted = operations or (OF_THE_CORE if primitives or sizes else DEFAULTS[backend])
        cases += _cases(backend, primitives, sizes or OWN_SIZES.get(backend), wanted)
        if "torch" in backends and backend in ("cpu", "cuda") and not sizes:
            drawn = [op for op in wanted if op in DRAWN]
            cases += _cases(backend, primitives or ORACLE_PRIMITIVES, ORACLE_SIZES, drawn)
    return list(dict.fromkeys(cases))


def peer_cases(cases: Sequence[Case], peers: Sequence[str]) -> list[Case]:
    """What these peers can be asked for of the GPU's cases."""
    on_gpu = [case for case in cases if case.backend == "cuda"]
    return [replace(case, backend=peer) for peer in peers for case in on_gpu if case.op in PEERS[peer]]


def sweep_cases(backends: Sequence[str]) -> list[Case]:
    """The cases of a chart: primitives at the default sizes, then sizes at 20,000 primitives."""
    cases = []
    for backend in backends:
        cases += _cases(backend, SWEEP_PRIMITIVES, None, OF_THE_CORE)
        cases += _cases(backend, [20_000], SWEEP_SIZES, DRAWN)
    return list(dict.fromkeys(cases))


def _cases(
    backend: str, primitives: Sequence[int] | None, sizes: Sequence[Size] | None, operations: Sequence[str]
) -> list[Case]:
    cases = []
    for op in (op for op in operations if op in OFFERED[backend]):
        counts = [0] if op in WITHOUT_SET else primitives or _own_primitives(backend, op)
        if op in WITHOUT_PICTURE:
            cases += [Case(op, "forward", backend, count, None, None) for count in counts]
        else:
            each = product(counts, sizes or DEFAULT_SIZES.get(op, OTHER_SIZES), directions_of(op))
            cases += [Case(op, direction, backend, count, *size) for count, size, direction in each]
    return cases


def directions_of(op: str) -> Sequence[str]:
    return DIRECTIONS[:1] if op in WITHOUT_GRADIENTS else DIRECTIONS


def _own_primitives(backend: str, op: str) -> Sequence[int]:
    """How many primitives an operation is timed on where nobody says."""
    if backend in ("torch", "embree"):
        return ORACLE_PRIMITIVES
    if backend == "cuda":
        if op in METHODS:
            return GPU_METHOD_PRIMITIVES.get(op, GPU_OTHER_METHOD_PRIMITIVES)
        return GPU_PRIMITIVES
    return DEFAULT_PRIMITIVES.get(op, OTHER_PRIMITIVES)
