"""Pictures of a sampled scene: path-traced once, then kept as an archive that other machines can be given."""

from __future__ import annotations

import io
import os
import uuid
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from envgs_bench.core import Camera

from ..formats.srgb import to_srgb
from ..notes import note
from ..path_tracer import PathTracer, Tracer
from ..split import TEST_EVERY
from .distribution import BRIGHT, BRIGHT_PERCENTILE, between
from .place import Place

Pictures = list[NDArray[np.uint8]]  # [H, W, 3] sRGB each

PROBES, PROBE_WIDTH, PROBE_SUPERSAMPLING = 8, 48, 3  # small pictures that the exposure is found by
FINER = 2  # × the supersampling of training views
BRIGHTEST = 2.5  # × what is white: so much a path counts at most


def traced_pictures(
    place: Place,
    cameras: Sequence[Camera],
    others: Sequence[Camera],
    supersampling: int,
    rng: np.random.Generator,
    tracer: Tracer,
) -> Pictures:
    """Those of the cameras, then of the others, all at one exposure, which the cameras alone decide.

    Those that test, and the others, have `FINER` as much supersampling, whose noise no method can meet.

    Raises DatasetError where Mitsuba is not installed.
    """
    traced = PathTracer([surface.traced() for surface in place.surfaces], place.sky, tracer)
    gain = _gain(traced, cameras, rng)
    pictures: dict[int, NDArray[np.uint8]] = {}
    every = range(len(cameras))
    test = every[::TEST_EVERY]
    for some, factor in ((test, FINER * supersampling), ([i for i in every if i not in test], supersampling)):
        lights = traced.clamped_lights([cameras[index] for index in some], factor, BRIGHTEST / gain, rng)
        for index, light in zip(some, lights, strict=True):
            pictures[index] = np.round(255 * to_srgb(gain * light)).astype(np.uint8)
    finest = traced.clamped_lights(others, FINER * supersampling, BRIGHTEST / gain, rng) if others else []
    unseen = [np.round(255 * to_srgb(gain * light)).astype(np.uint8) for light in finest]
    return [*(pictures[index] for index in every), *unseen]


def _gain(tracer: PathTracer, cameras: Sequence[Camera], rng: np.random.Generator) -> float:
    """What brings the bright parts of all views to a level that the distribution says."""
    probes = []
    for camera in cameras[:: max(1, len(cameras) // PROBES)]:
        scale = PROBE_WIDTH / camera.width
        intrinsics = camera.intrinsics.clone()
        intrinsics[:2] *= scale
        height = max(8, round(scale * camera.height))
        probes.append(Camera(camera.world_to_camera, intrinsics, PROBE_WIDTH, height))
    lights = [light.mean(-1).ravel() for light in tracer.clamped_lights(probes, PROBE_SUPERSAMPLING, np.inf, rng)]
    bright = float(np.percentile(np.concatenate(lights), BRIGHT_PERCENTILE))
    return between(rng, BRIGHT) / max(bright, 1e-6)


def kept_pictures(path: Path, count: int, make: Callable[[], Pictures]) -> Pictures:
    """Those in the archive at `path`, or else `make()`'s, which are then kept there.

    The archive is a ZIP of PNG files, 0000.png and so on. One that is damaged, or holds another number, is made again.
    Where nothing can be written they are returned nevertheless, with a note: they took minutes.
    """
    if path.is_file():
        try:
            with zipfile.ZipFile(path) as archive:
                names = sorted(archive.namelist())
                if len(names) == count:
                    return [np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGB")) for name in names]
        except (OSError, ValueError, zipfile.BadZipFile):
            pass
    pictures = make()
    try:
        _keep(path, pictures)
    except OSError as error:
        note(f"traced pictures could not be kept in {path.parent}: {error}")
    return pictures


def _keep(path: Path, pictures: Pictures) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
            for index, picture in enumerate(pictures):
                stream = io.BytesIO()
                Image.fromarray(picture).save(stream, "PNG", compress_level=6)
                archive.writestr(f"{index:04d}.png", stream.getvalue())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)  # there only where it could not be finished


def archive_name(key: dict[str, Any], digest: str) -> str:
    return f"sampled-{key['seed']}-{key['width']}x{key['height']}-{digest}.zip"
