"""Other rasterizers on the same workload, where they are installed: what `bench core --peers` adds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor
from torch.nn.functional import pad

from envgs_bench.core import Camera, GaussianSet


@dataclass
class PeerImage:
    """What a peer draws in its cheapest mode that yields a color; None for what that mode leaves out."""

    color: Tensor  # [H, W, 3]
    alpha: Tensor  # [H, W]
    normal: Tensor | None = None  # [H, W, 3]
    depth: Tensor | None = None  # [H, W]
    hits: Tensor | None = None


def why_unavailable() -> str | None:
    try:
        import gsplat  # noqa: F401
    except ImportError as error:
        return f"gsplat cannot be imported ({error}): pip install gsplat ninja, with CUDA's compiler present"
    return None


def peer_drawing(gaussians: GaussianSet, camera: Camera, near: float) -> Callable[[], PeerImage]:
    """A call of gsplat's rasterizer for this kind of Gaussian.

    It is asked for no depth and for none of the set's extras, which ours returns too.
    """
    from gsplat import rasterization, rasterization_2dgs

    view, intrinsics = camera.world_to_camera[None], camera.intrinsics[None]
    common = {"viewmats": view, "Ks": intrinsics, "width": camera.width, "height": camera.height, "near_plane": near,
              "sh_degree": gaussians.sh_degree, "packed": False}  # fmt: skip

    def fields(scales: Tensor) -> dict[str, Tensor]:
        return {"means": gaussians.means, "quats": gaussians.quaternions, "scales": scales,
                "opacities": gaussians.opacities, "colors": gaussians.sh}  # fmt: skip

    def surfels() -> PeerImage:
        scales = pad(gaussians.scales, (0, 1), value=1.0)  # gsplat wants a third, and does not read it
        color, alpha, normal, *_ = rasterization_2dgs(**fields(scales), **common)
        return PeerImage(color[0], alpha[0, ..., 0], normal[0])

    def gaussians_3d() -> PeerImage:
        color, alpha, _ = rasterization(**fields(gaussians.scales), **common)
        return PeerImage(color[0], alpha[0, ..., 0])

    return surfels if gaussians.is_surfels else gaussians_3d
