"""Look: what somebody wants to see, and the picture of it, of one run or of two with one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, View
from envgs_bench.stages.pictures import error_picture

from .opened import IMAGE, OpenedRun, Picture, as_picture
from .resolution import Size
from .sheets import named

PHOTOGRAPH, ERROR = "photograph", "error"  # what there is at the cameras of photographs only
LEAST_NAMED_ROWS = 200  # of a picture in which the halves' names can be read
SAME_PLACE = 1e-3  # of the scene's radius: a camera this near to a view's stands where it does
SAME_TURN_DEGREES = 0.1


@dataclass(frozen=True)
class Side:
    """One half of the picture, or all of it."""

    run: OpenedRun
    layer: str  # one of `layers_of`


@dataclass(frozen=True)
class Look:
    """What is to be seen.

    Attributes:
        camera: of the whole picture at its full size.
        left: what is seen left of the divide, everywhere where there is no `right`.
        divide: where the right half begins, as a share of the width.
    """

    camera: Camera
    left: Side
    right: Side | None = None
    divide: float = 0.5

    def picture(self, size: Size) -> Picture:
        """The picture drawn with that many pixels; the names of two halves stand at its bottom."""
        camera = self.camera.resized(*size)
        if self.right is None:
            return as_picture(_drawn(self.left, camera)[0])
        column = min(max(round(self.divide * size[0]), 1), size[0] - 1)
        left, left_name = _drawn(self.left, columns(camera, 0, column))
        right, right_name = _drawn(self.right, columns(camera, column, size[0]))
        halves = [as_picture(left), as_picture(right)]
        if size[1] >= LEAST_NAMED_ROWS:  # on either side of the divide, where no control stands
            halves = [named(halves[0], left_name, right=True, bottom=True), named(halves[1], right_name, bottom=True)]
        return np.concatenate(halves, axis=1)


def layers_of(run: OpenedRun) -> list[str]:
    """The layers that can be asked for: those that the method draws, and what a photograph gives."""
    return [*run.draw(run.views[0].camera.resized(16, 12)), PHOTOGRAPH, ERROR]


def view_at(run: OpenedRun, camera: Camera) -> View | None:
    """The run's view whose photograph was taken from where `camera` stands and looks, if any."""
    for view in run.views:
        near = float((view.camera.center - camera.center).norm()) <= SAME_PLACE * run.scene.radius
        turn = view.camera.world_to_camera[:3, :3].double() @ camera.world_to_camera[:3, :3].double().T
        if near and float(turn.trace()) >= 1 + 2 * math.cos(math.radians(SAME_TURN_DEGREES)):
            return view
    return None


def photograph_in(view: View, camera: Camera) -> tuple[Tensor, Tensor]:
    """The view's photograph as `camera`, which stands and looks as its own does, sees it.

    Returns:
        [H, W, 3] in [0, 1], sRGB, and [H, W] bool: where the photograph is.
    """
    shrunk = float(camera.intrinsics[1, 1] / view.camera.intrinsics[1, 1])
    image, own = view.rgb().permute(2, 0, 1)[None], view.camera
    if shrunk < 1:
        size = max(1, round(own.height * shrunk)), max(1, round(own.width * shrunk))
        image = functional.interpolate(image, size, mode="bilinear", antialias=True, align_corners=False)
        own = own.resized(size[1], size[0])
    pixels = camera.rays()[1] @ own.world_to_camera[:3, :3].T @ own.intrinsics.T  # K·R·direction: pixels times 1
    places = 2 * pixels[..., :2] / torch.tensor([own.width, own.height]) - 1
    seen = functional.grid_sample(image, places[None], padding_mode="border", align_corners=False)[0].permute(1, 2, 0)
    return seen, (places.abs() <= 1).all(dim=-1)


def columns(camera: Camera, first: int, end: int) -> Camera:
    """The camera of a picture's columns from `first` up to `end`."""
    shift = torch.zeros_like(camera.intrinsics)
    shift[0, 2] = first
    return replace(camera, intrinsics=camera.intrinsics - shift, width=end - first)


def _drawn(side: Side, camera: Camera) -> tuple[Tensor, str]:
    """The side's layer, and its name in words."""
    drawn = side.run.draw(camera)
    if side.layer not in (PHOTOGRAPH, ERROR):
        return drawn[side.layer], f"{side.run.label}: {side.layer}"
    view = view_at(side.run, camera)
    if view is None:
        return drawn[IMAGE], f"{side.run.label}: {IMAGE} ({side.layer}: at test cameras only)"
    photograph, there = photograph_in(view, camera)
    if side.layer == PHOTOGRAPH:
        return photograph * there[..., None], f"{side.layer} {view.name}"
    return error_picture(drawn[IMAGE], photograph) * there, f"{side.run.label}: {side.layer} at {view.name}"
