"""Normal estimation: a function of the user's estimates normals from pictures, for methods to train with."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera, View
from envgs_bench.import_path import load_import_path

from ..errors import DatasetError
from ..formats.normal_maps import world_normals
from ..progress import report

Estimator = Callable[[NDArray[np.uint8], Camera], NDArray]  # sRGB [H, W, 3] -> camera frame [H, W, 3]


def with_estimated_normals(views: Sequence[View], path: str | None) -> Iterator[View]:
    """The views with the normals that the function at import path `path` sees in them; as they are where it is None;
    one after the other, each estimated when it is asked for.

    The function gets the picture [H, W, 3], sRGB bytes, and its camera, and returns [H, W, 3] in the camera's frame
    (x right, y down, z forward), of any length; what is shorter than ½ is unknown. It is called from one thread.

    Raises:
        DatasetError: it cannot be imported, fails, or returns something else; or the views have normals already.
    """
    if path is None:
        yield from views
        return
    if any(view.normal is not None for view in views):
        raise DatasetError(
            f"dataset.normal_estimator={path}: the training views have normals already; drop the estimator, or "
            "move the normals away"
        )
    estimate = _function(path)
    for done, view in enumerate(views, start=1):
        estimated = replace(view, normal=_estimated(view, estimate, path))
        report("estimating normals", done, len(views))
        yield estimated


def estimator_version(path: str | None) -> str | None:
    """A hash of the file that the estimator comes from: where that changes, normals are estimated again."""
    if path is None:
        return None
    try:  # without importing it, which may take long and is needless where all is cached
        source = importlib.util.find_spec(path.partition(":")[0])
    except (ImportError, ValueError):
        return None
    if source is None or source.origin is None or not Path(source.origin).is_file():
        return None
    return hashlib.sha256(Path(source.origin).read_bytes()).hexdigest()


def _function(path: str) -> Estimator:
    try:
        return load_import_path(path)
    except ImportError as error:
        raise DatasetError(
            f"dataset.normal_estimator={path!r} cannot be imported ({error}); expected package.module:function"
        ) from error


def _estimated(view: View, estimate: Estimator, path: str) -> torch.Tensor:
    try:
        found = np.asarray(estimate(view.image.numpy(), view.camera))
    except Exception as error:  # whatever somebody else's function raises
        raise DatasetError(f"dataset.normal_estimator={path}: failed on image {view.name} ({error!r})") from error
    if found.shape != tuple(view.image.shape) or found.dtype.kind != "f":
        raise DatasetError(
            f"dataset.normal_estimator={path}: returned {found.dtype} {list(found.shape)} for image {view.name}, "
            f"expected floats {list(view.image.shape)}"
        )
    finite = np.nan_to_num(found.astype(np.float32), posinf=0, neginf=0)
    return world_normals(torch.from_numpy(finite), view.camera, "camera")
