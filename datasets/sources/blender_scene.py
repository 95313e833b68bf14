"""A blender scene out of its photographs: views, which are split already, and points to start from."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from envgs_bench.core import Placement, Scene

from ..formats.photograph import Photograph
from ..formats.point_clouds import PointCloud, RandomPoints
from ..photographs.fitting import fit_to_files
from ..photographs.normal_estimation import with_estimated_normals
from ..photographs.placing import placed_cloud, placed_photographs, sights_of
from ..photographs.views import read_views
from ..split import validation_of, without_normals
from ..store.scene_file import on_disk
from .settings import BlenderSettings

BOX = 1.3  # half the edge of 3DGS's cube of random points
CAMERAS_OUT = 4.0  # NeRF's cameras' distance from its middle


def make_blender_scene(
    choice: BlenderSettings, photographs: Sequence[Photograph], learned: int, measured: PointCloud | None
) -> Scene:
    """The scene of these photographs, of which the first `learned` train and the others test.

    Args:
        measured: points in the data's coordinates; None: they are random.
    """
    fitted = fit_to_files(photographs)
    placed, placement = placed_photographs(fitted, measured, choice.root)
    cloud = placed_cloud(measured, placement) if measured else _random_points(choice, fitted, placement)
    views = on_disk(read_views(placed, choice.downsample, choice.background, choice.mask_labels))
    train, test = views[:learned], views[learned:]
    val = validation_of(train)
    if not choice.train_normals:
        train = without_normals(train)
    train = on_disk(with_estimated_normals(train, choice.normal_estimator))
    background = torch.tensor(choice.background)
    return Scene(choice.scene_name, train, test, *cloud, background, val, placement=placement)


def _random_points(choice: BlenderSettings, photographs: Sequence[Photograph], placement: Placement) -> PointCloud:
    if choice.random_box is not None:
        return RandomPoints(choice.random_points, choice.random_box).placed(placement)
    around = None if placement.unmoved else sights_of(photographs).looked_at()
    if around is None:
        return RandomPoints(choice.random_points, BOX).placed(Placement())
    x, y, z = placement.points_from_data(around[0]).tolist()
    half = BOX / CAMERAS_OUT * around[1] / placement.scale
    return RandomPoints(choice.random_points, half, (x, y, z)).placed(Placement())
