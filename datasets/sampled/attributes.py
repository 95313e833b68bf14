"""Attributes: what a sampled scene is like, as numbers computed from its truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy import ndimage

from envgs_bench.core import View

from ..formats.srgb import to_linear
from ..toy.world import Array
from .points import Cloud
from .truth import Mask, Truth

CELL = 8  # pixels along the cells that hold points or none
TEXTURED = 0.03  # standard deviation of light in a cell that shows something
SMOOTH_STEP = 0.05  # relative difference of depth up to which neighbors are of one surface


def attributes_of(
    views: Sequence[View], truths: Sequence[Truth], exact: Sequence[Array], cloud: Cloud
) -> dict[str, float]:
    """Of the training views; shares are in [0, 1].

    Args:
        views: with the normals that are learned from.
        exact: their true normals.

    Returns:
        `reflective` and the other regions of materials as shares of the pixels; `near_field`, `self_field` and
        `far_field` as shares of the reflective ones. `roughness` is their mean. `curvature` of theirs, 1/m, and
        `mirrored_distance`, m, are medians. `texture` is the mean gradient of sRGB a pixel. `view_angle` is the median
        between neighboring views, degrees. `points_missing` is the share of textured cells without a point.
        `brightness_range` is in stops, from the 2nd to the 98th percentile. `clipped` is the share of white pixels,
        `sky` of those that meet nothing. `normals_off` is the mean angle of the normals given, degrees.
    """
    regions = {name: np.stack([truth.regions[name] for truth in truths]) for name in truths[0].regions}
    shining = regions["reflective"]
    found = {name: float(regions[name].mean()) for name in ("reflective", "mirror", "rough", "coated", "transmissive")}
    found |= {name: _share(regions[name], shining) for name in ("near_field", "self_field", "far_field")}
    rough = np.stack([truth.roughness for truth in truths])
    found["roughness"] = float(rough[shining].mean()) if shining.any() else 0.0
    mirrored = np.stack([truth.mirrored for truth in truths])[shining]
    found["mirrored_distance"] = float(np.median(mirrored[mirrored > 0])) if (mirrored > 0).any() else 0.0
    found["curvature"] = _curvature(views, truths, exact)
    light = [view.image.double().numpy().mean(-1) / 255 for view in views]
    found["texture"] = float(np.mean([np.hypot(*np.gradient(one)).mean() for one in light]))
    found |= {"views": float(len(views)), "view_angle": _view_angle(views)}
    found |= {"points": float(len(cloud.points)), "points_missing": _missing(views, light, cloud)}
    linear = np.concatenate([to_linear(one[::4, ::4]).ravel() for one in light])
    low, high = np.percentile(linear, (2, 98))
    found["brightness_range"] = float(np.log2(max(high, 1e-3) / max(low, 1e-3)))
    found["clipped"] = float(np.mean([(view.image.numpy().min(-1) == 255).mean() for view in views]))
    found["sky"] = float(np.mean([(truth.depth == 0).mean() for truth in truths]))
    found["normals_off"] = _angle(views, exact)
    return found


def _share(part: Mask, whole: Mask) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else 0.0


def _curvature(views: Sequence[View], truths: Sequence[Truth], exact: Sequence[Array]) -> float:
    """How much reflective surfaces' normals turn, over the way between neighboring pixels' points: the median."""
    found = []
    for view, truth, normal in zip(views, truths, exact, strict=True):
        origins, directions = (rays.double().numpy() for rays in view.camera.rays())
        points = origins + truth.depth[..., None] * directions
        both = truth.regions["reflective"][:, 1:] & truth.regions["reflective"][:, :-1]
        step = np.linalg.norm(np.diff(points, axis=1), axis=-1)
        near = both & (np.abs(np.diff(truth.depth, axis=1)) < SMOOTH_STEP * truth.depth[:, 1:]) & (step > 0)
        found.append((np.linalg.norm(np.diff(normal, axis=1), axis=-1)[near] / step[near]).ravel())
    every = np.concatenate(found)
    return float(np.median(every)) if every.size else 0.0


def _view_angle(views: Sequence[View]) -> float:
    """Between each view's direction and its nearest neighbor's, seen from what all look at."""
    centers = torch.stack([view.camera.center for view in views]).double().numpy()
    forward = torch.stack([view.camera.world_to_camera[2, :3] for view in views]).double().numpy()
    # the point that is nearest to all optical axes
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    middle = np.linalg.solve(across.sum(0), np.einsum("vij,vj->i", across, centers))
    toward = centers - middle
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = toward @ toward.T
    np.fill_diagonal(cosine, -1)
    return float(np.median(np.degrees(np.arccos(np.clip(cosine.max(1), -1, 1)))))


def _missing(views: Sequence[View], light: Sequence[Array], cloud: Cloud) -> float:
    points, without, textured = torch.from_numpy(cloud.points).float(), 0, 0
    for view, one in zip(views, light, strict=True):
        rows, columns = view.camera.height // CELL, view.camera.width // CELL
        cells = one[: rows * CELL, : columns * CELL].reshape(rows, CELL, columns, CELL)
        shows = cells.std(axis=(1, 3)) > TEXTURED
        pixels, depth = (values.numpy() for values in view.camera.project(points))
        cell = np.floor(pixels[depth > 0] / CELL).astype(int)
        inside = (cell >= 0).all(1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
        has = np.zeros((rows, columns), bool)
        has[cell[inside, 1], cell[inside, 0]] = True
        has = ndimage.binary_dilation(has)
        without, textured = without + int((shows & ~has).sum()), textured + int(shows.sum())
    return without / max(textured, 1)


def _angle(views: Sequence[View], exact: Sequence[Array]) -> float:
    found = []
    for view, true in zip(views, exact, strict=True):
        assert view.normal is not None
        known = np.any(true, axis=-1)
        cosine = (view.normal.numpy()[known] * true[known]).sum(-1)
        found.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    every = np.concatenate(found)
    return float(every.mean()) if every.size else 0.0
