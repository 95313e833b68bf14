"""PathTracer: pictures by Mitsuba of meshes under a sky, with every bounce of light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .errors import DatasetError
from .progress import streamed
from .toy.shapes import Mesh

Array = NDArray[np.floating[Any]]
Bsdf = dict[str, Any]  # as Mitsuba's load_dict takes it; a texture is `Texture`

Tracer = Literal["cpu", "gpu"]
# The first needs nothing but Mitsuba; the second NVIDIA's driver with OptiX. Each repeats its own pictures; the other's
# are the same but for the noise of their paths.
VARIANTS: dict[Tracer, str] = {"cpu": "scalar_rgb", "gpu": "cuda_ad_rgb"}
DEPTH = 9  # edges of the longest path
MOST_PATHS = 2**26  # traced at once on a GPU: some 5 GB of its memory


@dataclass(frozen=True)
class Texture:
    """A picture over a surface's (u, v), upright, bilinear, clamped at its edges."""

    linear: Array  # [H, W, 3]


@dataclass(frozen=True)
class TracedSurface:
    """A mesh and what it is made of."""

    mesh: Mesh
    bsdf: Bsdf
    radiance: Texture | None = None  # what it sends out by itself


class PathTracer:
    """Surfaces under a sky as Mitsuba's scene.

    Args:
        sky: [H, W, 3] linear radiance from infinity; row 0 looks to +z, columns run counterclockwise from +x.
        tracer: which of Mitsuba's variants; that of a GPU is for one thread.

    Raises:
        DatasetError: Mitsuba is not installed, or has no such GPU.
    """

    def __init__(self, surfaces: Sequence[TracedSurface], sky: Array, tracer: Tracer = "cpu") -> None:
        self._mitsuba, self._on_gpu = _imported(tracer), tracer == "gpu"
        shapes = {f"surface{index}": self._shape(surface) for index, surface in enumerate(surfaces)}
        self._scene = self._mitsuba.load_dict({"type": "scene", **shapes, "sky": self._sky(sky)})
        self._integrator = self._mitsuba.load_dict({"type": "path", "max_depth": DEPTH})

    def light(self, camera: Camera, supersampling: int, seed: int) -> Array:
        """The view [H, W, 3], linear: a pixel is its area's mean over supersampling² paths, well spread over it.

        A GPU traces all of them at once: see `MOST_PATHS` for the memory that they take.
        """
        sampler = {"type": "multijitter", "sample_count": supersampling**2}
        sensor = self._mitsuba.load_dict(self._sensor(camera) | {"sampler": sampler})
        return self._rendered(sensor, supersampling**2, seed)

    def clamped_lights(
        self, cameras: Sequence[Camera], supersampling: int, most: float, rng: np.random.Generator
    ) -> Iterator[Array]:
        """The views of one size [H, W, 3], linear: means over supersampling² paths, one through each part of a pixel.

        None counts for more than `most`: one that meets a lamp in a mirror by chance is a speckle otherwise, however
        many others there are.
        """
        size = self._views_at_once(cameras, supersampling)
        batches = [list(cameras[first : first + size]) for first in range(0, len(cameras), size)]
        seeds = rng.integers(2**31, size=len(cameras)).tolist()

        def lights(index: int) -> list[Array]:
            batch = batches[index]
            fine = [c.resized(supersampling * c.width, supersampling * c.height) for c in batch]
            light = torch.from_numpy(self._rendered(self._side_by_side(fine), 1, seeds[index]))
            shape = (batch[0].height, supersampling, len(batch) * batch[0].width, supersampling, 3)
            mean = light.nan_to_num_().clamp_(max=most).reshape(shape).mean((1, 3))
            return np.split(mean.numpy(), len(batch), axis=1)

        for views in streamed("tracing views", lights, range(len(batches)), 1 if self._on_gpu else None):
            yield from views

    def _views_at_once(self, cameras: Sequence[Camera], supersampling: int) -> int:
        """Several on a GPU: to prepare a picture takes it as long as to trace some."""
        if not self._on_gpu or not cameras:
            return 1
        return max(1, MOST_PATHS // (supersampling**2 * cameras[0].width * cameras[0].height))

    def _side_by_side(self, cameras: Sequence[Camera]) -> Any:
        """A sensor of all of them, whose pictures are of one size."""
        sampler = {"type": "independent", "sample_count": 1}
        if len(cameras) == 1:
            return self._mitsuba.load_dict(self._sensor(cameras[0]) | {"sampler": sampler})
        sensors = {f"camera{index:05}": self._sensor(camera) for index, camera in enumerate(cameras)}
        film = _film(len(cameras) * cameras[0].width, cameras[0].height)
        return self._mitsuba.load_dict({"type": "batch", **sensors, "film": film, "sampler": sampler})

    def _rendered(self, sensor: Any, paths: int, seed: int) -> Array:
        if self._on_gpu:  # where a seed that is part of the kernel would have it compiled each time
            import drjit

            seed = drjit.opaque(self._mitsuba.UInt32, seed)
        light = self._mitsuba.render(self._scene, sensor=sensor, integrator=self._integrator, spp=paths, seed=seed)
        return np.array(light)

    def _sensor(self, camera: Camera) -> dict[str, Any]:
        # a camera of Mitsuba's has x to the left and y up
        pose = np.linalg.inv(camera.world_to_camera.double().numpy()) @ np.diag([-1.0, -1.0, 1.0, 1.0])
        focal = float(camera.intrinsics[0, 0])
        return {
            "type": "perspective",
            "to_world": self._mitsuba.ScalarTransform4f(pose.tolist()),
            "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * focal)))),
            "fov_axis": "x",
            "near_clip": 1e-3,
            "film": _film(camera.width, camera.height),
        }

    def _shape(self, surface: TracedSurface) -> Any:
        mi, mesh = self._mitsuba, surface.mesh
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(self._with_textures(surface.bsdf))
        if surface.radiance is not None:
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": self._texture(surface.radiance)})
        shape = mi.Mesh(
            "surface",
            vertex_count=len(mesh.vertices),
            face_count=len(mesh.faces),
            has_vertex_normals=True,
            has_vertex_texcoords=True,
            props=properties,
        )
        values = mi.traverse(shape)
        values["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        values["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
        values["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
        values["faces"] = mesh.faces.astype(np.uint32).ravel()
        values.update()
        return shape

    def _with_textures(self, bsdf: Bsdf) -> Bsdf:
        """The same, as Mitsuba takes it."""
        return {key: self._given(value) for key, value in bsdf.items()}

    def _given(self, value: Any) -> Any:
        if isinstance(value, Texture):
            return self._texture(value)
        return self._with_textures(value) if isinstance(value, dict) else value

    def _texture(self, texture: Texture) -> dict[str, Any]:
        bitmap = self._mitsuba.Bitmap(np.ascontiguousarray(texture.linear, dtype=np.float32))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}

    def _sky(self, sky: Array) -> dict[str, Any]:
        """Light from infinity. Mitsuba's panoramas have y up, and their columns run clockwise from +z."""
        mi = self._mitsuba
        bitmap = mi.Bitmap(np.ascontiguousarray(sky[:, ::-1], dtype=np.float32))
        upright = mi.ScalarTransform4f().rotate([0, 0, 1], -90).rotate([1, 0, 0], 90)
        return {"type": "envmap", "bitmap": bitmap, "to_world": upright}


def _film(width: int, height: int) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}


def _imported(tracer: Tracer) -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise DatasetError(
            "this scene is path-traced by Mitsuba, which is not installed: pip install 'envgs-bench[mitsuba]'"
        ) from error
    try:
        mitsuba.set_variant(VARIANTS[tracer])
    except (ImportError, AttributeError, RuntimeError) as error:
        raise DatasetError(
            f"Mitsuba cannot trace on this machine's {tracer}: {error}; give dataset.tracer=cpu"
        ) from error
    return mitsuba
