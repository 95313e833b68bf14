"""Gaussians that another program wrote, drawn by the shared core as those of a method are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Camera, Placement, Rendering, Scene
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.model import NEAR
from envgs_bench.methods.settings import GaussianSettings
from envgs_bench.methods.storage.gaussian_files import drawable, read_gaussian_file
from envgs_bench.parts import BASE

MOST_LOG_SCALE = 80.0  # beyond, a float32 scale or its square is infinite


@dataclass(frozen=True)
class OpenedSettings(GaussianSettings):
    """Colors of any degree, as the file has them."""

    sh_degree: int = 3


class Opened(GaussianMethod):
    """Gaussians of a file.

    Attributes:
        centered: whether cameras' principal points are taken to be in the middle of the picture.
    """

    Settings: ClassVar[type] = OpenedSettings
    centered = False

    def render(self, camera: Camera) -> Rendering:
        return super().render(_centered(camera) if self.centered else camera)

    def picture(self, camera: Camera) -> Tensor:
        return super().picture(_centered(camera) if self.centered else camera)


class OpenedGaussians(Opened):
    """3D Gaussians of a file."""

    axes = 3
    cuda_graph: ClassVar[bool] = True


class OpenedSurfels(Opened):
    """Surfels of a file."""

    axes = 2
    cuda_graph: ClassVar[bool] = True


def open_gaussians(
    path: Path, scene: Scene, near: float | None = None, device: str = "cpu", centered: bool = False
) -> GaussianMethod:
    """The file's Gaussians as a method that is ready to `prepare` and `render`, in the world of the scene.

    Those that have values that are not finite are left out, and the method's notes say how many.

    Args:
        path: as of `read_gaussian_file`, in the coordinates of the scene's data.
        near: nothing nearer to a camera is drawn, in the data's units; None: as our methods do.
        centered: as of `Opened`.

    Raises:
        ValueError: as `read_gaussian_file`, or the file holds no Gaussian.
    """
    tensors = read_gaussian_file(path)
    kept = drawable(tensors)
    if not kept.any():
        spoiled = f" of finite values, but {len(kept)} others" if len(kept) else ""
        raise ValueError(f"{path}: holds no Gaussian{spoiled}")
    tensors = _in_world({name: values[kept] for name, values in tensors.items()}, scene.placement)
    surfels = tensors["log_scales"].shape[1] == 2
    method = (OpenedSurfels if surfels else OpenedGaussians)(OpenedSettings(), device)
    at = torch.device(device)
    closest = max(NEAR, scene.free_space) if near is None else near / scene.placement.scale
    state = {
        "sets": {BASE: {name: values.to(at) for name, values in tensors.items()}},
        **{"radius": scene.radius, "near": closest, "background": scene.background.to(at)},
    }
    method.restore(state)
    method.centered = centered
    if left_out := int((~kept).sum()):
        method.notes.append(
            f"{path.name}: {left_out:,} of {len(kept):,} Gaussians have values that are not finite, and are left out"
        )
    return method


def _in_world(tensors: dict[str, Tensor], placement: Placement) -> dict[str, Tensor]:
    means = torch.from_numpy(placement.points_from_data(tensors["means"].numpy())).float()
    log_scales = (tensors["log_scales"] - math.log(placement.scale)).clamp(max=MOST_LOG_SCALE)
    return {**tensors, "means": means, "log_scales": log_scales}


def _centered(camera: Camera) -> Camera:
    middle = camera.intrinsics.clone()
    middle[0, 2], middle[1, 2] = camera.width / 2, camera.height / 2
    return replace(camera, intrinsics=middle)
