"""Which code draws: one folder a backend, chosen by device, the same results from each.

| backend | draws | on |
|---|---|---|
| cpu | rasterize, trace | native C++, SIMD, all cores |
| cuda | all of it | CUDA C++ compiled at first use |
| torch | rasterize, trace | plain autograd, any dtype: the oracle |
| embree | trace | closest hits re-cast by Embree: the independent oracle |
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import torch

from .contract import Backend

if TYPE_CHECKING:  # each module is held to what it is to offer
    from . import cpu, cuda, embree
    from . import torch as oracle
    from .contract import ColorKernels, ImageKernels, Rasterizer

    _TRACERS: tuple[Backend, ...] = (cpu, cuda, oracle, embree)
    _RASTERIZERS: tuple[Rasterizer, ...] = (cpu, cuda, oracle)
    _COLOR_KERNELS: ColorKernels = cuda
    _IMAGE_KERNELS: ImageKernels = cuda

BACKENDS = ("cpu", "cuda", "torch", "embree")


def load_backend(name: str, device: torch.device, dtype: torch.dtype) -> Backend:
    """The backend module called `name`; "auto" takes `cuda` for CUDA tensors and `cpu` otherwise.

    Raises:
        ValueError: no such backend, or it cannot take tensors of this device and dtype.
        RuntimeError: the backend does not work on this machine; the message says why and what to do.
    """
    if name == "auto":
        name = "cuda" if device.type == "cuda" else "cpu"
    if name not in BACKENDS:
        raise ValueError(f"unknown backend {name!r}, expected auto or one of {', '.join(BACKENDS)}")
    if name in ("cpu", "cuda") and (device.type != name or dtype != torch.float32):
        raise ValueError(
            f"backend {name!r} takes float32 tensors on {name}, got {dtype} on {device}; "
            "convert them, or use backend='torch'"
        )
    module: Backend = importlib.import_module(f"{__package__}.{name}")
    reason = module.why_unavailable()
    if reason:
        raise RuntimeError(f"backend {name!r} does not work here: {reason}")
    return module


def available_backends() -> dict[str, str | None]:
    """For each backend None where it works on this machine, else one sentence that says why not."""
    reasons: dict[str, str | None] = {}
    for name in BACKENDS:
        try:
            reasons[name] = importlib.import_module(f"{__package__}.{name}").why_unavailable()
        except Exception as error:  # whatever a broken installation may raise: the others still work
            reasons[name] = f"cannot be imported: {type(error).__name__}: {error}"
    return reasons
