"""Which code draws: one folder a backend, chosen by device, the same results from each.

A backend module offers some of

    rasterize(gaussians, camera, options: RasterizeOptions) -> Rendering
    trace(gaussians, origins [R, 3], directions [R, 3], bvh, options: TraceOptions) -> Rendering, one value a ray
    reflect(image, camera, offset, alpha_min, beta_min) -> origins, directions, β
    depth_normals(depth [H, W], camera) -> normals [H, W, 3]
    ssim_map(image [H, W, C], target, taps, pad, c1, c2) -> SSIM of every pixel and channel
    build_bvh(gaussians) -> Bvh
    why_unavailable() -> str | None: one sentence for the user, or None where it works

Where `reflect`, `depth_normals` or `ssim_map` is missing, torch's formula serves.

| backend | draws | on |
|---|---|---|
| cpu | rasterize, trace | native C++, SIMD, all cores |
| cuda | all of it | CUDA C++ compiled at first use |
| torch | rasterize, trace | plain autograd, any dtype: the oracle |
| embree | trace | closest hits re-cast by Embree: the independent oracle |
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from types import ModuleType

import torch
from torch import Tensor

BACKENDS = ("cpu", "cuda", "torch", "embree")


@dataclass(frozen=True)
class RasterizeOptions:
    background: Tensor  # [3]
    near: float
    low_pass: bool
    transmittance_min: float


@dataclass(frozen=True)
class TraceOptions:
    background: Tensor  # [3]
    t_min: float
    transmittance_min: float
    sh_along_ray: bool  # else toward each primitive's center


def load_backend(name: str, device: torch.device, dtype: torch.dtype) -> ModuleType:
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
    module = importlib.import_module(f"{__package__}.{name}")
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
