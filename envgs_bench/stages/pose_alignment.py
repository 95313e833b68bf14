"""Pose alignment: the camera near a scored view's own at which a model's picture is nearest to the photograph.

A model of wrong cameras may be right and stand elsewhere: at a scored view's exact camera its picture is then shifted,
which costs more than any blur. PSNR after the alignment leaves that out. It is found by least squares over pixels, from
coarse to fine, through the same drawing that is scored: whatever a method draws, it need not be differentiable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.method import Method
from envgs_bench.metrics import Protocol
from envgs_bench.records import Scores
from envgs_bench.settings import RunSettings

from .perturbations import cameras_moved
from .scoring import FULL

ALIGNED = "psnr_aligned"
FACTORS = (8, 4, 2, 1)  # pixels are averaged over squares of so many, one after the other
FEWEST_PIXELS = 20  # along a picture's shorter side, averaged
ROUNDS = 8  # of least squares a factor
STEP = 0.25  # averaged pixels that a picture moves for a difference
SETTLED = 1e-3  # the share of the squared error by which a round has to lower it

Draw = Callable[[Camera], Tensor]  # [H, W, 3] sRGB


@dataclass(frozen=True)
class Alignment:
    """How a run's scored views are aligned.

    Attributes:
        distance: how far surfaces are from cameras, roughly, world units.
    """

    protocol: Protocol
    distance: float

    def scores(self, method: Method, view: View) -> dict[str, Scores]:
        """PSNR of the aligned view, over the full image and inside each region that it shows, by the view's masks."""

        def draw(camera: Camera) -> Tensor:
            return method.render(camera.to(method.device)).color.cpu()

        target = view.rgb()
        drawn = draw(aligned_camera(draw, view.camera, target, self.distance))
        regions = {FULL: None, **{region: mask for region, mask in view.masks.items() if mask.any()}}
        only = ("psnr",)
        return {
            region: {ALIGNED: self.protocol.score(drawn, target, mask, only)["psnr"]}
            for region, mask in regions.items()
        }


def alignment_of(settings: RunSettings, scene: Scene, protocol: Protocol) -> Alignment | None:
    """None where the run's training cameras are those of the data."""
    return Alignment(protocol, scene.radius) if cameras_moved(settings) else None


def aligned_camera(draw: Draw, camera: Camera, photograph: Tensor, distance: float) -> Camera:
    """The camera near this one at which what is drawn is nearest to the photograph, by squared error.

    Args:
        camera: on the CPU.
        photograph: [H, W, 3] floats in [0, 1], sRGB.
        distance: how far surfaces are from the camera, roughly: turning it by a pixel, and moving it by a pixel's share
            of this, are steps of one length.

    Returns:
        The camera itself where nothing nearer was found.
    """
    found = camera
    for factor in FACTORS:
        if min(camera.width, camera.height) >= FEWEST_PIXELS * factor:
            found = _nearest(draw, found, photograph, factor, distance)
    errors = [float((draw(each).clamp(0, 1) - photograph).square().mean()) for each in (camera, found)]
    return found if errors[1] < errors[0] else camera


def _nearest(draw: Draw, camera: Camera, photograph: Tensor, factor: int, distance: float) -> Camera:
    from scipy.optimize import least_squares  # takes 0.2 s to import

    pixel = factor / float(camera.intrinsics[0, 0])  # radians
    units = pixel * np.array([1, 1, 1, distance, distance, distance])
    wanted = _averaged(photograph, factor)

    def residuals(change: NDArray[np.float64]) -> NDArray[np.float64]:
        drawn = torch.nan_to_num(draw(moved(camera, change * units))).clamp(0, 1)
        return (_averaged(drawn, factor) - wanted).flatten().double().numpy()

    def differences(change: NDArray[np.float64]) -> NDArray[np.float64]:
        here = residuals(change)
        return np.stack([(residuals(change + step) - here) / STEP for step in STEP * np.eye(6)], axis=1)

    found = least_squares(residuals, np.zeros(6), differences, ftol=SETTLED, max_nfev=ROUNDS)
    return moved(camera, found.x * units)


def moved(camera: Camera, change: NDArray[np.float64]) -> Camera:
    """The camera turned by a rotation vector (radians, the first three) and moved (world units), in its own axes."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(change[:3]).as_matrix(), change[3:]
    pose = torch.from_numpy(motion) @ camera.world_to_camera.double()
    return replace(camera, world_to_camera=pose.to(camera.world_to_camera.dtype))


def _averaged(image: Tensor, factor: int) -> Tensor:
    """[3, H // factor, W // factor] of [H, W, 3]."""
    return functional.avg_pool2d(image.movedim(-1, 0), factor)
