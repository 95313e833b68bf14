"""Placing of photographs and their points: in the data's coordinates before, in the scene's world afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from envgs_bench.core import Placement

from ..formats.photograph import Photograph
from ..formats.point_clouds import PointCloud
from ..placing import placement_of
from ..sights import Sights


def placed_photographs(
    photographs: Sequence[Photograph], cloud: PointCloud | None, source: object
) -> tuple[list[Photograph], Placement]:
    """The photographs with their poses in the scene's world, and where that lies in the data's.

    Args:
        cloud: points that were measured, in the data's coordinates; None where there are none, or random ones.
        source: what notes call the data.
    """
    if not photographs:
        return [], Placement()
    placement = placement_of(sights_of(photographs, cloud), source)
    if placement.unmoved:
        return list(photographs), placement
    return [replace(p, world_to_camera=placement.pose_from_data(p.world_to_camera)) for p in photographs], placement


def sights_of(photographs: Sequence[Photograph], cloud: PointCloud | None = None) -> Sights:
    """Where the photographs were taken from, and what they may show; in their own coordinates."""
    return Sights(
        np.stack([photograph.world_to_camera for photograph in photographs]),
        np.array([photograph.camera.mean_focal_length() for photograph in photographs]),
        np.array([[photograph.camera.width, photograph.camera.height] for photograph in photographs], np.float64),
        np.zeros((0, 3)) if cloud is None else cloud.points.double().numpy(),
    )


def placed_cloud(cloud: PointCloud, placement: Placement) -> PointCloud:
    """The cloud's points in the scene's world, float32."""
    if placement.unmoved:
        return cloud._replace(points=cloud.points.float())
    return cloud._replace(points=torch.from_numpy(placement.points_from_data(cloud.points)).float())
