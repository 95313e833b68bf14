"""Intrinsics: whether focal lengths and principal point are those of pictures of this size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from ..errors import DatasetError, listed
from ..notes import note

if TYPE_CHECKING:  # with pycolmap, which scenes' views do without, and torch, which photographs do without
    from envgs_bench.core import View

    from ..formats.photograph import Photograph

WIDEST, WIDE = 165.0, 130.0  # degrees, along the longer edge: nobody draws a pinhole's picture beyond the first
NARROW, NARROWEST = 3.0, 0.3  # degrees
OFF_CENTER = 0.2  # of an edge, from the picture's middle: a crop's, or a mistake
ALIKE = 0.06  # of both edges: intrinsics of another size move the principal point by the same share of each
SQUEEZED = 1.15  # between the two focal lengths: pixels are square in photographs


class Intrinsics(NamedTuple):
    """A pinhole's, or a lens' in its middle; pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def field_of_view(self) -> float:
        """Degrees along the edge where it is wider, as if the principal point were in the middle."""
        return math.degrees(2 * math.atan(max(self.width / self.fx, self.height / self.fy) / 2))

    @property
    def off_center(self) -> float:
        """How far the principal point is from the middle, in shares of an edge, the larger of both."""
        return max(abs(self.cx / self.width - 0.5), abs(self.cy / self.height - 0.5))

    @property
    def described(self) -> str:
        return (
            f"focal lengths {self.fx:.4g} and {self.fy:.4g}, principal point ({self.cx:.4g}, {self.cy:.4g}), "
            f"{self.width}×{self.height} pixels"
        )


def check_intrinsics(photographs: Iterable[Photograph]) -> None:
    """Refuse cameras that cannot have taken their pictures.

    Raises:
        DatasetError: a field of view that no lens has, or a principal point as of pictures of another size.
    """
    seen: set[str] = set()
    for photograph in photographs:
        camera = photograph.camera
        if photograph.camera_id in seen or not camera.is_perspective():
            continue
        seen.add(photograph.camera_id)
        matrix = camera.calibration_matrix()
        found = Intrinsics(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], camera.width, camera.height)
        wrong = impossible(found, fisheye=camera.is_perspective_fisheye())
        if wrong:
            raise DatasetError(f"{photograph.path}: its camera {photograph.camera_id} ({found.described}) {wrong}")


def impossible(camera: Intrinsics, fisheye: bool = False) -> str | None:
    """Why there is no such camera, and what to do; None where there may be one."""
    angle = camera.field_of_view
    if not fisheye and angle > WIDEST:
        return (
            f"would have a field of view of {angle:.0f}°. Focal lengths are pixels of these pictures: neither "
            "millimeters nor shares of the width"
        )
    if angle < NARROWEST:
        return f"would have a field of view of {angle:.2g}°. Focal lengths are pixels of these pictures; correct them"
    across, down = camera.cx / camera.width, camera.cy / camera.height
    if camera.off_center > OFF_CENTER and abs(across - down) < ALIKE * max(1, across + down):
        whole = f"{round(2 * camera.cx)}×{round(2 * camera.cy)}"
        if min(across, down) < ALIKE:
            return "has its principal point in the first pixel's corner. Give it in pixels from there, as (w/2, h/2)"
        return (
            f"has the principal point of pictures of {whole} pixels. Use images of that size, or state the size that "
            "the numbers hold for (w and h, or COLMAP's width and height): they are scaled to that of the files"
        )
    swapped = abs(camera.cx - camera.height / 2) + abs(camera.cy - camera.width / 2) < 0.02 * camera.width
    if swapped and camera.off_center > ALIKE:
        return "has the principal point of pictures turned by 90°. Exchange cx and cy, fx and fy; or turn the images"
    return None


def check_views(where: str, views: Sequence[View]) -> None:
    """Refuse views whose cameras cannot have taken their pictures, and note those of odd intrinsics.

    Raises:
        DatasetError: as `check_intrinsics`.
    """
    odd: dict[str, list[str]] = {}
    for view in views:
        camera, k = view.camera, view.camera.intrinsics.tolist()
        found = Intrinsics(k[0][0], k[1][1], k[0][2], k[1][2], camera.width, camera.height)
        wrong = impossible(found)
        if wrong:
            raise DatasetError(f"{where}: view {view.name}: its camera ({found.described}) {wrong}")
        for oddity in _oddities(found):
            odd.setdefault(oddity, []).append(view.name)
    for oddity, names in odd.items():
        note(f"{where}: {len(names)} of {len(views)} views have {oddity}: {listed(names)}")


def _oddities(camera: Intrinsics) -> list[str]:
    found = []
    if camera.off_center > OFF_CENTER:
        found.append(
            "a principal point far from the picture's middle, which is right for crops alone; check cx, cy, width and "
            "height"
        )
    if not NARROW <= camera.field_of_view <= WIDE:
        found.append(
            f"a field of view of {'more' if camera.field_of_view > WIDE else 'less'} than "
            f"{WIDE if camera.field_of_view > WIDE else NARROW:g}°; check that focal lengths are pixels of these files"
        )
    ratio = camera.fx / camera.fy
    if not 1 / SQUEEZED <= ratio <= SQUEEZED:
        found.append(
            "different focal lengths in x and y, which is right for pictures that were squeezed alone; check "
            "fl_x and fl_y, or camera_angle_x and camera_angle_y"
        )
    return found
