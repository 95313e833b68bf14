"""The shared core: `rasterize`, `trace`, both for color alone, `depth_normals`, `reflect`, and the plain types."""

from .backends import available_backends
from .camera import Camera
from .contract import Bvh
from .gaussians import GaussianSet
from .normals import depth_normals
from .placement import Placement
from .rasterize import rasterize, rasterize_color
from .reflect import reflect
from .removals import removal_gradients
from .rendering import Rendering, Statistics
from .scene import Scene, View
from .threads import torch_on_one_thread
from .trace import build_bvh, trace, trace_color

__all__ = [
    "Bvh",
    "Camera",
    "GaussianSet",
    "Placement",
    "Rendering",
    "Scene",
    "Statistics",
    "View",
    "available_backends",
    "build_bvh",
    "depth_normals",
    "rasterize",
    "rasterize_color",
    "reflect",
    "removal_gradients",
    "torch_on_one_thread",
    "trace",
    "trace_color",
]
