"""reflect(): the rays that a drawn image reflects."""

from __future__ import annotations

import torch
from torch import Tensor

from .backends import load_backend
from .camera import Camera
from .contract import ImageKernels
from .rendering import Rendering
from .vectors import unit

ALPHA_MIN = 1e-2  # what has less alpha, or a shorter blended normal, is no surface


def reflect(
    image: Rendering,
    camera: Camera,
    *,
    offset: float = 0.0,
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
        camera: that it was drawn for, of the same size, dtype and device.
        offset: how far above the surface a ray starts, world units.
        beta_min: pixels whose β is not above this do not reflect visibly; a tensor of one value is not waited for.
            Those whose alpha or blended normal is not longer than 0.01 have no surface to reflect at.
        backend: "auto" (by device) or a name, as for `trace`.

    Returns:
        Origins [H, W, 3], unit directions [H, W, 3], world frame, and β [H, W]; direction and β are 0 where nothing
        reflects.

    Raises:
        ValueError: the image's fields, the camera and a tensor `beta_min` disagree in size, dtype or device, or the
            image has no extras.
        RuntimeError: the backend does not work on this machine.
    """
    _check(image, camera, beta_min)
    module = load_backend(backend, image.alpha.device, image.alpha.dtype)
    if isinstance(module, ImageKernels):
        return module.reflect(image, camera, offset, ALPHA_MIN, beta_min)
    depth, normal, beta = image.depth, image.normal, image.extras[..., 0]
    reflects = (image.alpha > ALPHA_MIN) & (normal.square().sum(-1) > ALPHA_MIN**2) & (beta > beta_min)
    rays = camera.rays()[1]
    normal = unit(normal)
    origins = torch.addcmul(camera.center + offset * normal, depth[..., None], rays)
    incoming = unit(rays)
    mirrored = incoming - 2 * (incoming * normal).sum(-1, keepdim=True) * normal
    return origins, torch.where(reflects[..., None], mirrored, 0.0), torch.where(reflects, beta, 0.0)


def _check(image: Rendering, camera: Camera, beta_min: Tensor | float) -> None:
    alpha, size = image.alpha, (camera.height, camera.width)
    camera.check_like(alpha, "image")
    for name, shape in (("alpha", size), ("depth", size), ("normal", (*size, 3)), ("extras", (*size, 1))):
        field = getattr(image, name)
        given = tuple(field[..., :1].shape if name == "extras" else field.shape)
        if given != shape or (field.dtype, field.device) != (alpha.dtype, alpha.device):
            raise ValueError(
                f"image.{name} is {field.dtype} {tuple(field.shape)} on {field.device}, expected {alpha.dtype} {shape} "
                f"on {alpha.device}, of the camera's size: give the camera that the image was drawn for"
            )
    if isinstance(beta_min, Tensor) and (
        beta_min.numel() != 1 or (beta_min.dtype, beta_min.device) != (alpha.dtype, alpha.device)
    ):
        raise ValueError(
            f"beta_min is {beta_min.dtype} {tuple(beta_min.shape)} on {beta_min.device}, expected a number, or one "
            f"value of {alpha.dtype} on {alpha.device}"
        )
