"""Lenses: whether a camera's distortion can be undone over the whole field that a view of it is to show."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pycolmap
from numpy.typing import NDArray

from ..errors import DatasetError
from ..formats.photograph import Photograph
from ..notes import note
from ..photographs.undistortion import PINHOLES, undistorted_camera

EDGE_POINTS = 24  # on each edge of the undistorted picture
STEPS = 32  # from its principal point outward to each of them
STEP = 1e-5  # of a ray's direction, for derivatives
BORDER, MOST_BORDER = 2.0, 0.05  # pixels, and share of the longer edge, that may be missing beside the photograph
LITTLE_SHOWN, LEAST_SHOWN = 0.25, 0.1  # shares of the photograph's area: worth a word, and of no use
REMEDY = (
    "Check the distortion's signs and order; or fit the camera again by a model of fewer parameters, as SIMPLE_RADIAL; "
    "or undistort or crop the images before"
)


class _Field(NamedTuple):
    """What the undistorted camera sees, in the photograph."""

    fold: float  # pixels from the principal point to where the lens folds back, infinite where it does not
    beyond: float  # pixels by which the field leaves the photograph at most
    shown: float  # share of the photograph's area


def check_lenses(photographs: Iterable[Photograph]) -> None:
    """Refuse cameras whose lens shows the same place twice, and note those of which little is left.

    Raises:
        DatasetError: a distortion folds back within the picture so that it cannot be undistorted, as of a polynomial
            that fits the middle of a picture and not its edges.
    """
    first: dict[tuple[str, int, int, tuple[float, ...]], Photograph] = {}
    for photograph in photographs:
        camera = photograph.camera
        if camera.model.name not in PINHOLES and camera.is_perspective():
            lens = (camera.model.name, camera.width, camera.height, tuple(camera.params))
            first.setdefault(lens, photograph)
    for lens, photograph in first.items():
        _check(photograph, _field(*lens))


def _check(photograph: Photograph, field: _Field) -> None:
    camera = photograph.camera
    lens = f"{photograph.path}: the lens of its camera {photograph.camera_id} ({described(camera)})"
    size = f"{camera.width}×{camera.height} pixels"
    if np.isfinite(field.fold):
        raise DatasetError(
            f"{lens} folds back {field.fold:.0f} pixels from the principal point: what lies beyond, within its {size}, "
            f"would be seen twice. {REMEDY}"
        )
    if field.beyond > MOST_BORDER * max(camera.width, camera.height) or field.shown < LEAST_SHOWN:
        raise DatasetError(
            f"{lens} folds back within its {size}: no pinhole camera sees more than {100 * field.shown:.0f} % of them, "
            f"or its picture has empty borders. {REMEDY}"
        )
    if field.beyond > BORDER:
        note(
            f"{lens} leaves {field.beyond:.0f} pixels along an edge of the undistorted picture empty: they repeat the "
            "photograph's border; crop or undistort the images before if that matters"
        )
    if field.shown < LITTLE_SHOWN:
        note(
            f"{lens} leaves {100 * field.shown:.0f} % of the photograph to a pinhole camera, the rest is cut off; "
            "check its parameters, or undistort the images before to several pinhole cameras"
        )


def described(camera: pycolmap.Camera) -> str:
    """Model and parameters, for a message."""
    names = [name.strip() for name in camera.params_info.split(",")]
    return f"{camera.model.name} " + ", ".join(
        f"{name}={value:.4g}" for name, value in zip(names, camera.params, strict=True)
    )


@lru_cache(maxsize=256)
def _field(model: str, width: int, height: int, params: tuple[float, ...]) -> _Field:
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    pinhole = undistorted_camera(camera)
    edge = _edge(pinhole)
    rays = np.linspace(1 / STEPS, 1, STEPS)[:, None, None] * edge
    pixels = _seen(camera, rays)
    center = _seen(camera, np.zeros((1, 2)))[0]
    folded = ~(_orientation(camera, rays) > 0) | ~np.isfinite(pixels).all(axis=-1)
    fold = np.inf
    if folded.any():
        reached = np.where(np.isfinite(pixels).all(axis=-1), np.linalg.norm(pixels - center, axis=-1), 0)
        before = np.cumsum(folded, axis=0) == 0  # along each radius, as far as it is not folded
        farthest = np.where(before, reached, 0).max(axis=0)
        fold = float(farthest[folded.any(axis=0)].min())
    border = pixels[-1]
    outside = np.maximum(-border, border - [width, height])
    x, y = border.T
    area = abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2
    return _Field(fold, float(np.nan_to_num(outside).max()), area / (width * height))


def _edge(pinhole: pycolmap.Camera) -> NDArray[np.float64]:
    """Points [N, 2] around the picture's edge, corners among them, in the plane z = 1."""
    along = np.linspace(0, 1, EDGE_POINTS, endpoint=False)
    zero, one = np.zeros_like(along), np.ones_like(along)
    sides = [(along, zero), (one, along), (1 - along, one), (zero, 1 - along)]
    around = np.concatenate([np.stack(side, axis=-1) for side in sides]) * [pinhole.width, pinhole.height]
    matrix = pinhole.calibration_matrix()
    return np.asarray((around - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])


def _seen(camera: pycolmap.Camera, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points [..., 2] in the plane z = 1 are seen."""
    points = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1)
    return np.asarray(camera.img_from_cam(points.reshape(-1, 3))).reshape(rays.shape)


def _orientation(camera: pycolmap.Camera, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """The determinant of the projection's derivative: negative where the picture is seen from behind."""
    steps = STEP * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    right, left, down, up = _seen(camera, rays + steps.reshape(4, *(1,) * (rays.ndim - 1), 2))
    (a, c), (b, d) = np.moveaxis(right - left, -1, 0), np.moveaxis(down - up, -1, 0)
    return np.asarray(a * d - b * c)
