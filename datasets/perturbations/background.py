"""Another background behind the scene: of all its views, test views too, since it is the scene that has another one."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Scene, View

from ..errors import DatasetError

FOREGROUND = "foreground"  # the region whose masks are a picture's alpha
EDGE = 2  # pixels by which a point of the foreground may be seen beside it: points are noisy


def replace_background(scene: Scene, gray: float, rng: object) -> Scene:
    """Every view laid on this gray, sRGB in [0, 1], and the scene's `background` said to be it.

    A pixel is opaque where it has a depth, or lies in the region `foreground` in views without depths. Points that some
    training view shows on its background, clear of an edge, are left out: they belong to the old background.

    Raises:
        DatasetError: a view has neither, or the background is not to be seen anywhere.
    """
    color = scene.background.new_full((3,), gray)
    changed = replace(
        scene,
        train=[_laid(view, color, scene.name) for view in scene.train],
        test=[_laid(view, color, scene.name) for view in scene.test],
        val=[_laid(view, color, scene.name) for view in scene.val],
        unseen={place: [_laid(view, color, scene.name) for view in views] for place, views in scene.unseen.items()},
        background=color,
    )
    if all(_opaque(view, scene.name).all() for view in scene.train):
        raise DatasetError(f"{scene.name} shows no background in its training views, so that it cannot be replaced")
    kept = ~_on_background(scene)
    return replace(changed, points=scene.points[kept], point_colors=scene.point_colors[kept])


def _laid(view: View, color: Tensor, scene: str) -> View:
    opaque = _opaque(view, scene)
    image = torch.where(opaque[..., None], view.image, (255 * color).round().byte())
    normal = None if view.normal is None else view.normal * opaque[..., None]
    return replace(view, image=image, normal=normal)


def _opaque(view: View, scene: str) -> Tensor:
    """[H, W] bool: where the view shows more than the background."""
    if view.depth is not None:
        return view.depth > 0
    if FOREGROUND in view.masks:
        return view.masks[FOREGROUND]
    raise DatasetError(
        f"{scene}: view {view.name} has neither depths nor a mask of the region {FOREGROUND}, so that its background "
        "is unknown and cannot be replaced; scenes of transparent pictures are laid on another by dataset.background"
    )


def _on_background(scene: Scene) -> Tensor:
    """[P] bool: which points project to the background of some training view, EDGE pixels clear of what is opaque."""
    from scipy import ndimage

    found = torch.zeros(len(scene.points), dtype=torch.bool)
    for view in scene.train:
        empty = torch.from_numpy(~ndimage.binary_dilation(_opaque(view, scene.name).numpy(), iterations=EDGE))
        pixels, depth = view.camera.project(scene.points.to(view.camera.intrinsics))
        column, row = pixels.floor().long().unbind(-1)
        width, height = view.camera.width, view.camera.height
        inside = (depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
        found |= inside & empty[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    return found
