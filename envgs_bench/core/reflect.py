"""reflect(): the rays that a drawn image reflects."""

from __future__ import annotations

import torch
from torch import Tensor

from .backends import load_backend
from .camera import Camera
from .contract import ImageKernels
from .rendering import Rendering
from .vectors import unit


def reflect(
    image: Rendering,
    camera: Camera,
    *,
    offset: float = 0.0,
    alpha_min: float = 1e-2,
    beta_min: Tensor | float = 0.0,
    backend: str = "auto",
) -> tuple[Tensor, Tensor, Tensor]:
    """A ray a pixel, the camera's mirrored at the pixel's surface (EnvGS paper, Eqs. 3 and 4).

    d_ref = d − 2(d·n)n of the unit camera ray d at the normalized blended normal n, from the camera ray's point at the
    expected depth, moved by `offset` along n. Differentiable in the image's depth, normal and extras. A pixel that does
    not reflect has a ray without a direction: it hits nothing in `trace`, at no cost, so that nobody needs to know how
    many there are.

    Args:
        image: a drawn image; `extras[..., 0]` is its blended β.
        camera: that it was drawn for.
        offset: how far above the surface a ray starts, world units.
        alpha_min: pixels whose alpha or blended normal is not longer than this have no surface to reflect at,
        beta_min: and those whose β is not above this do not reflect visibly; a tensor of one value is not waited for.
        backend: "auto" (by device) or a name, as for `trace`.

    Returns:
        Origins [H, W, 3], unit directions [H, W, 3], world frame, and β [H, W]; direction and β are 0 where nothing
        reflects.
    """
    module = load_backend(backend, image.alpha.device, image.alpha.dtype)
    if isinstance(module, ImageKernels):
        return module.reflect(image, camera, offset, alpha_min, beta_min)
    depth, normal, beta = image.depth, image.normal, image.extras[..., 0]
    reflects = (image.alpha > alpha_min) & (normal.square().sum(-1) > alpha_min**2) & (beta > beta_min)
    rays = camera.rays()[1]
    normal = unit(normal)
    origins = torch.addcmul(camera.center + offset * normal, depth[..., None], rays)
    incoming = unit(rays)
    mirrored = incoming - 2 * (incoming * normal).sum(-1, keepdim=True) * normal
    return origins, torch.where(reflects[..., None], mirrored, 0.0), torch.where(reflects, beta, 0.0)
