"""Other rasterizers on the same workload, where they are installed: what `bench core --peers` adds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize, pad

from envgs_bench.core import Camera, GaussianSet


@dataclass
class PeerImage:
    """What a peer draws in its cheapest mode that yields a color; None for what that mode leaves out."""

    color: Tensor  # [H, W, 3]
    alpha: Tensor  # [H, W]
    normal: Tensor | None = None  # [H, W, 3]
    depth: Tensor | None = None  # [H, W]
    hits: Tensor | None = None


@dataclass
class PackedImage:
    """HiGS's picture in half precision, which is taken apart when somebody asks, not when it is drawn."""

    frame: Tensor  # [H, W, 4], color and transmittance

    @property
    def color(self) -> Tensor:
        return self.frame[..., :3]

    @property
    def alpha(self) -> Tensor:
        return 1 - self.frame[..., 3]


def why_unavailable(peer: str = "gsplat") -> str | None:
    """Why a peer cannot be asked here, None if it can."""
    try:
        if peer == "gsplat":
            import gsplat  # noqa: F401
        else:
            from gsplat.experimental import GaussianInferenceRenderer  # noqa: F401
    except ImportError as error:
        where = "pip install gsplat" if peer == "gsplat" else "it needs gsplat newer than 1.5.3, from its main branch"
        return f"{peer} cannot be imported ({error}): {where}, with ninja and CUDA's compiler present"
    return None


def gsplat_drawing(gaussians: GaussianSet, camera: Camera, near: float) -> Callable[[], PeerImage]:
    """A call of gsplat's rasterizer for this kind of Gaussian, as for training.

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


def higs_drawing(gaussians: GaussianSet, camera: Camera, near: float) -> Callable[[], PackedImage]:
    """A call of gsplat's renderer for inference. It packs the set, of 3D Gaussians, here and not in the call."""
    from gsplat.experimental import GaussianInferenceRenderer, GaussianInferenceScene

    with torch.inference_mode():
        scene = GaussianInferenceScene.from_gaussian_tensors(
            gaussians.means,
            normalize(gaussians.quaternions, dim=-1),
            gaussians.scales,
            gaussians.opacities,
            gaussians.sh,
            gaussians.sh_degree,
            "none",  # no compression of colors
            id="workload",
        )
    renderer = GaussianInferenceRenderer(scene)
    view, intrinsics = (x.float().contiguous() for x in (camera.world_to_camera, camera.intrinsics))

    @torch.inference_mode()
    def draw() -> PackedImage:
        drawn = renderer.render(viewmat=view, K=intrinsics, width=camera.width, height=camera.height, near_plane=near)
        return PackedImage(drawn.frame[0])

    return draw
