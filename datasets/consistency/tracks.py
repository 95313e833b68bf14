"""Tracks: whether a COLMAP model's cameras see its points where its images show them."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from numpy.typing import NDArray

from ..errors import DatasetError, listed
from ..notes import note

PER_IMAGE = 64  # observations that are looked at, evenly over an image's
LEAST = 8  # of an image, to speak of it
WRONG, ODD = 0.02, 0.005  # median error, in shares of a picture's longer edge; structure from motion leaves 0.001
OUTSIDE = 0.1  # share of observations beside their picture that is no rounding
ODD_PIXELS = 2.0  # and more than so many: small pictures are coarse
SCALED = 0.1  # share of the error that a scale may leave where it explains it


class _Track(NamedTuple):
    """What one image's observations say."""

    name: str
    edge: int  # the longer one, pixels
    errors: NDArray[np.float64]  # [K] shares of the longer edge; infinite behind the camera
    rescaled: NDArray[np.float64]  # [K] the same after the observations are scaled to fit
    scale: float  # of the observations' pixels to the camera's
    outside: float  # share beside the picture
    behind: float  # share behind the camera


def check_tracks(folder: Path, model: pycolmap.Reconstruction) -> None:
    """Refuse a model whose cameras, poses, points and observations are not of each other, and note odd images.

    A model without observations, as of known poses, says nothing of itself and passes. Observations of points that are
    not there any more are ignored.

    Args:
        folder: names it in messages.

    Raises:
        DatasetError: points lie behind most cameras, far from where images show them, or beside the pictures.
    """
    known = frozenset(model.points3D)  # people thin clouds, and images still show what is gone
    posed = [image for image in model.images.values() if image.has_pose]
    tracks = [track for image in posed if (track := _track(image, model, known))]
    if not tracks:
        return
    errors = np.concatenate([track.errors for track in tracks])
    median = float(np.median(errors))
    outside = float(np.mean([track.outside for track in tracks]))
    scale = float(np.median([track.scale for track in tracks]))
    if median > ODD and np.median(np.concatenate([track.rescaled for track in tracks])) < SCALED * median:
        note(
            f"{folder}: images show points {scale:.3g} times as far out as its cameras see them: cameras.bin (or .txt) "
            "was scaled and images.bin was not. The views are right if the cameras' size is the pictures'"
        )
        return
    if median > WRONG:
        behind = float(np.mean([track.behind for track in tracks]))
        where = (
            "behind their cameras: poses are world to camera, x right, y down, z forward"
            if behind > 0.5
            else f"{100 * median:.0f} % of a picture's edge from where images show them (median)"
        )
        raise DatasetError(
            f"{folder}: its points lie {where}. cameras, images and points3D are not of one model, or one of them was "
            "changed alone; export all of them together"
        )
    if outside > OUTSIDE:
        raise DatasetError(
            f"{folder}: {100 * outside:.0f} % of what images show of its points lies beside the pictures: width and "
            "height in cameras are of another size than the focal lengths; correct them"
        )
    if median > ODD and np.median(np.concatenate([track.errors * track.edge for track in tracks])) > ODD_PIXELS:
        note(
            f"{folder}: its points lie {100 * median:.1f} % of a picture's edge from where images show them (median); "
            "structure from motion leaves a tenth of that. Adjust the bundle again"
        )
    _note_odd_images(folder, tracks)


def _note_odd_images(folder: Path, tracks: list[_Track]) -> None:
    odd = sorted(track.name for track in tracks if np.median(track.errors) > WRONG)
    if odd:
        note(
            f"{folder}: {len(odd)} of {len(tracks)} images show points more than {100 * WRONG:g} % of an edge from "
            f"where their poses see them (median): {listed(odd)}; remove them or place them again"
        )


@np.errstate(all="ignore")
def _track(image: pycolmap.Image, model: pycolmap.Reconstruction, known: Set[int]) -> _Track | None:
    observations = [image.point2D(int(index)) for index in image.get_observation_point2D_idxs()]
    observations = [point for point in observations if point.point3D_id in known]
    if len(observations) < LEAST:
        return None
    chosen = [observations[i] for i in np.linspace(0, len(observations) - 1, PER_IMAGE).astype(int)]
    shown = np.array([point.xy for point in chosen])
    points = np.array([model.points3D[point.point3D_id].xyz for point in chosen])
    camera = model.cameras[image.camera_id]
    seen_from = points @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
    seen = np.asarray(camera.img_from_cam(seen_from))
    behind = seen_from[:, 2] <= 0 if camera.is_perspective() else np.zeros(len(points), dtype=bool)
    edge = max(camera.width, camera.height)
    ahead = ~behind & np.isfinite(seen).all(axis=1)
    scale = _scale(shown[ahead], seen[ahead])
    outside = ((shown < -1) | (shown > np.array([camera.width, camera.height]) + 1)).any(axis=1)
    return _Track(
        image.name,
        edge,
        _distance(shown, seen, ahead) / edge,
        _distance(shown / scale, seen, ahead) / edge,
        scale,
        float(outside.mean()),
        float(behind.mean()),
    )


def _scale(shown: NDArray[np.float64], seen: NDArray[np.float64]) -> float:
    """By which the places shown are farther from the picture's first corner than those seen; 1 where none is seen."""
    out = np.linalg.norm(seen, axis=1)
    return max(float(np.median(np.linalg.norm(shown, axis=1) / np.maximum(out, 1e-9))), 1e-9) if len(seen) else 1.0


def _distance(shown: NDArray[np.float64], seen: NDArray[np.float64], ahead: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(ahead, np.linalg.norm(shown - np.where(ahead[:, None], seen, 0), axis=1), np.inf)
