"""Which code draws: one folder a backend, chosen by device, the same results from each.

A backend is a module with the functions of `Backend`, and of `Rasterizer`, `ColorTracer` and `ImageKernels` where it
offers those.

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
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import torch
from torch import Tensor

if TYPE_CHECKING:
    from . import cpu, cuda, embree
    from . import torch as oracle
    from .camera import Camera
    from .gaussians import GaussianSet
    from .rendering import Rendering
    from .trace import Bvh

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


class Backend(Protocol):
    """What every backend module offers."""

    def why_unavailable(self) -> str | None:
        """One sentence for the user, or None where it works."""

    def build_bvh(self, gaussians: GaussianSet) -> Bvh: ...

    def trace(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
    ) -> Rendering:
        """Rays [R, 3] drawn to one value a ray, [R, …]."""


@runtime_checkable
class Rasterizer(Protocol):
    """A backend that draws images too."""

    def rasterize(self, gaussians: GaussianSet, camera: Camera, options: RasterizeOptions) -> Rendering: ...


@runtime_checkable
class ColorTracer(Protocol):
    """A backend that traces faster what nobody differentiates; elsewhere `trace` serves."""

    def trace_color(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, bvh: Bvh | None, options: TraceOptions
    ) -> tuple[Tensor, Tensor]:
        """Color [R, 3] and alpha [R] of rays [R, 3]."""


@runtime_checkable
class ImageKernels(Protocol):
    """A backend with its own code for what is computed from drawn images; elsewhere torch's formulas serve."""

    def reflect(
        self, image: Rendering, camera: Camera, offset: float, alpha_min: float, beta_min: Tensor | float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Origins [H, W, 3], directions [H, W, 3] and β [H, W]."""

    def depth_normals(self, depth: Tensor, camera: Camera) -> Tensor:
        """Normals [H, W, 3] from depths [H, W]."""

    def ssim_map(
        self, image: Tensor, target: Tensor, taps: tuple[float, ...], pad: int, c1: float, c2: float
    ) -> Tensor:
        """SSIM of every pixel and channel of images [H, W, C]."""


if TYPE_CHECKING:  # each module is held to what it is to offer
    _TRACERS: tuple[Backend, ...] = (cpu, cuda, oracle, embree)
    _RASTERIZERS: tuple[Rasterizer, ...] = (cpu, cuda, oracle)
    _COLOR_TRACER: ColorTracer = cuda
    _IMAGE_KERNELS: ImageKernels = cuda


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
