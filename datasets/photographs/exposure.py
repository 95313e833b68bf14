"""Equal exposure: by how much a camera's automatic exposure and white balance brightened each photograph.

A point that several photographs see has one color, but for what view and light change. So

    log c(view, point) = log e(view) + log b(point) + residual

in each color channel, with the exposures e as factors on sRGB bytes (a camera's curve is close to a power, which keeps
factors factors). Highlights and wrong matches make a few residuals large: the sum of their absolute values is what is
minimized, by reweighted least squares. Each point's brightness is solved for in closed form, so that one small system
remains, with a row a view. Only ratios are determined: the exposures' geometric mean is 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter
from scipy import sparse

from ..errors import DatasetError, listed
from ..formats.colmap_model import Observations
from ..formats.photograph import Photograph
from ..formats.pictures import Bytes, Color, read_picture
from ..notes import note
from ..progress import mapped
from .fitting import fit_to_file

PATCH_RADIUS = 3  # pixels around a point whose mean is its color
MIN_BYTE, MAX_BYTE = 10, 245  # bytes; beyond, a camera's curve or the sensor's limit distorts factors
MIN_POINTS = 20  # points that a view must share with others for its exposure to be known
MIN_RESIDUAL = 0.01  # below this logarithmic difference all residuals weigh the same: noise
ITERATIONS = 20


def with_equal_exposure(
    photographs: Sequence[Photograph], observations: Mapping[str, Observations], background: Color
) -> list[Photograph]:
    """The photographs with the `gains` that make all exposures equal; how far these reach is noted.

    Args:
        observations: by the photographs' names.
        background: sRGB, behind transparent pictures.

    Raises:
        DatasetError: a picture cannot be read or has another shape than its camera, or no view shows enough points.
    """
    seen = mapped("measuring exposure", lambda p: _colors(p, observations[p.name], background), photographs)
    views = np.repeat(np.arange(len(seen)), [len(points) for points, _ in seen])
    points = np.unique(np.concatenate([points for points, _ in seen]), return_inverse=True)[1]
    logs = np.log(np.concatenate([colors for _, colors in seen]))
    exposures = np.exp(np.stack([view_offsets(views, points, channel, len(seen)) for channel in logs.T], axis=1))
    known = np.bincount(views, minlength=len(seen)) >= MIN_POINTS
    if not known.any():
        raise DatasetError(
            "dataset.equalize_exposure=true needs a model that says which image shows which points; this one does not: "
            "export it with its tracks (POINTS2D in images, TRACK in points3D), or set equalize_exposure=false"
        )
    exposures[~known] = 1
    _note_reach(photographs, exposures, known)
    return [replace(p, gains=tuple(own)) for p, own in zip(photographs, (1 / exposures).tolist(), strict=True)]


def view_offsets(
    views: NDArray[np.int64], points: NDArray[np.int64], values: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """The offsets a [count] that minimize Σ |value − a(view) − b(point)| over a, of mean 0, and b.

    Views that share no points, directly or through others, say nothing of each other: each such group has mean 0.

    Args:
        views: [K] the view of each observation, below `count`.
        points: [K] its point.
        values: [K] what was observed.
    """
    shape = (count, int(points.max(initial=0)) + 1)
    weights = np.ones(len(values))
    offsets = np.zeros(count)
    for _ in range(ITERATIONS):
        weight = sparse.csr_array((weights, (views, points)), shape)
        weighted = sparse.csr_array((weights * values, (views, points)), shape)
        of_points = weight.sum(axis=0)
        share = weight * (1 / np.maximum(of_points, 1e-12))  # [count, P]: a view's part in what is known of a point
        system = np.diag(weight.sum(axis=1)) - (share @ weight.T).toarray()
        right = weighted.sum(axis=1) - share @ weighted.sum(axis=0)
        offsets = np.linalg.lstsq(system, right, rcond=1e-9)[0]
        means = (weighted.sum(axis=0) - offsets @ weight) / np.maximum(of_points, 1e-12)
        weights = 1 / np.maximum(np.abs(values - offsets[views] - means[points]), MIN_RESIDUAL)
    return offsets - offsets.mean()


def brightened(picture: Bytes, gains: Color) -> Bytes:
    """The picture [H, W, 3] with each channel's bytes multiplied by its gain, rounded and cut at 255."""
    tables = np.clip(np.round(np.arange(256)[:, None] * np.asarray(gains)), 0, 255).astype(np.uint8)
    return np.stack([tables[picture[..., channel], channel] for channel in range(3)], axis=-1)


def _colors(
    photograph: Photograph, observed: Observations, background: Color
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The points that the picture shows well enough exposed [K], and their colors [K, 3] as bytes."""
    fitted = fit_to_file(photograph)
    picture = Image.fromarray(read_picture(fitted.path, background, fitted.turned)[0])
    smooth = np.asarray(picture.filter(ImageFilter.BoxBlur(PATCH_RADIUS)))
    scale = np.array([fitted.camera.width / photograph.camera.width, fitted.camera.height / photograph.camera.height])
    columns, rows = np.floor(observed.positions * scale).astype(np.int64).T
    inside = (columns >= 0) & (columns < smooth.shape[1]) & (rows >= 0) & (rows < smooth.shape[0])
    colors, points = smooth[rows[inside], columns[inside]], observed.points[inside]
    usable = ((colors > MIN_BYTE) & (colors < MAX_BYTE)).all(axis=1)
    return points[usable], colors[usable].astype(np.float64)


def _note_reach(photographs: Sequence[Photograph], exposures: NDArray, known: NDArray[np.bool_]) -> None:
    brightness = np.exp(np.log(exposures).mean(axis=1))
    text = f"exposures from {brightness.min():.2f} to {brightness.max():.2f} of their mean were made equal"
    unknown = [photograph.name for photograph, sure in zip(photographs, known, strict=True) if not sure]
    if unknown:
        text += f"; too few points say how these were exposed, which stay as they are: {listed(unknown)}"
    note(text)
