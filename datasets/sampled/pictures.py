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
from ..path_tracer import PathTracer, Tracer
from ..progress import streamed
from ..toy.world import Array
from .distribution import BRIGHT, BRIGHT_PERCENTILE, between
from .place import Place

Pictures = list[NDArray[np.uint8]]  # [H, W, 3] sRGB each

PROBES, PROBE_WIDTH, PROBE_PATHS = 8, 48, 9  # small pictures that the exposure is found by
BRIGHTEST = 2.5  # × what is white: so much a path counts at most


def traced_pictures(
    place: Place, cameras: Sequence[Camera], supersampling: int, rng: np.random.Generator, tracer: Tracer
) -> Pictures:
    """All at one exposure. Raises DatasetError where Mitsuba is not installed."""
    traced = PathTracer([surface.traced() for surface in place.surfaces], place.sky, tracer)
    gain = _gain(traced, cameras, rng)
    seeds = rng.integers(2**31, size=(len(cameras), supersampling**2)).tolist()

    def picture(index: int) -> NDArray[np.uint8]:
        light = gain * traced.clamped_light(cameras[index], seeds[index], BRIGHTEST / gain)
        return np.round(255 * to_srgb(light)).astype(np.uint8)

    cores = 1 if tracer == "gpu" else None
    return list(streamed("tracing views", picture, range(len(cameras)), cores))


def _gain(tracer: PathTracer, cameras: Sequence[Camera], rng: np.random.Generator) -> float:
    """What brings the bright parts of all views to a level that the distribution says."""
    lights: list[Array] = []
    for camera in cameras[:: max(1, len(cameras) // PROBES)]:
        scale = PROBE_WIDTH / camera.width
        intrinsics = camera.intrinsics.clone()
        intrinsics[:2] *= scale
        probe = Camera(camera.world_to_camera, intrinsics, PROBE_WIDTH, max(8, round(scale * camera.height)))
        seeds = rng.integers(2**31, size=PROBE_PATHS).tolist()
        lights.append(tracer.clamped_light(probe, seeds, np.inf).mean(-1).ravel())
    bright = float(np.percentile(np.concatenate(lights), BRIGHT_PERCENTILE))
    return between(rng, BRIGHT) / max(bright, 1e-6)


def kept_pictures(path: Path, count: int, make: Callable[[], Pictures]) -> Pictures:
    """Those in the archive at `path`, or else `make()`'s, which are then kept there.

    The archive is a ZIP of PNG files, 0000.png and so on. One that is damaged, or holds another number, is made again.
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
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        for index, picture in enumerate(pictures):
            stream = io.BytesIO()
            Image.fromarray(picture).save(stream, "PNG", compress_level=6)
            archive.writestr(f"{index:04d}.png", stream.getvalue())
    os.replace(part, path)
    return pictures


def archive_name(key: dict[str, Any], digest: str) -> str:
    return f"sampled-{key['seed']}-{key['width']}x{key['height']}-{digest}.zip"
