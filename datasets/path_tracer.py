"""PathTracer: pictures by Mitsuba of meshes under a sky, with every bounce of light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .errors import DatasetError
from .toy.shapes import Mesh

Array = NDArray[np.floating[Any]]
Bsdf = dict[str, Any]  # as Mitsuba's load_dict takes it; a texture is `Texture`

Tracer = Literal["cpu", "gpu"]
# The first needs nothing but Mitsuba; the second NVIDIA's driver with OptiX. Each repeats its own pictures; the other's
# are the same but for the noise of their paths.
VARIANTS: dict[Tracer, str] = {"cpu": "scalar_rgb", "gpu": "cuda_ad_rgb"}
DEPTH = 9  # edges of the longest path


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
        tracer: which of Mitsuba's variants; that of a GPU takes one picture at a time, from one thread.

    Raises:
        DatasetError: Mitsuba is not installed, or has no such GPU.
    """

    def __init__(self, surfaces: Sequence[TracedSurface], sky: Array, tracer: Tracer = "cpu") -> None:
        self._mitsuba, self._on_gpu = _imported(tracer), tracer == "gpu"
        shapes = {f"surface{index}": self._shape(surface) for index, surface in enumerate(surfaces)}
        self._scene = self._mitsuba.load_dict({"type": "scene", **shapes, "sky": self._sky(sky)})
        self._integrator = self._mitsuba.load_dict({"type": "path", "max_depth": DEPTH})

    def light(self, camera: Camera, supersampling: int, seed: int) -> Array:
        """The view [H, W, 3], linear: a pixel is its area's mean over supersampling² paths, well spread over it."""
        sampler = {"type": "multijitter", "sample_count": supersampling**2}
        return self._rendered(self._sensor(camera, sampler), supersampling**2, seed)

    def clamped_light(self, camera: Camera, seeds: Sequence[int], most: float) -> Array:
        """The view [H, W, 3], linear: the mean over one path a seed, none of which counts for more than `most`.

        A path that meets a lamp in a mirror by chance is a speckle otherwise, however many others there are.
        """
        sensor = self._sensor(camera, {"type": "independent", "sample_count": 1})
        total = np.zeros((camera.height, camera.width, 3), np.float32)
        for seed in seeds:
            total += np.minimum(np.nan_to_num(self._rendered(sensor, 1, seed)), most)
        return total / len(seeds)

    def _rendered(self, sensor: Any, paths: int, seed: int) -> Array:
        if self._on_gpu:  # where a seed that is part of the kernel would have it compiled each time
            import drjit

            seed = drjit.opaque(self._mitsuba.UInt32, seed)
        light = self._mitsuba.render(self._scene, sensor=sensor, integrator=self._integrator, spp=paths, seed=seed)
        return np.array(light)[..., :3]

    def _sensor(self, camera: Camera, sampler: dict[str, Any]) -> Any:
        mi = self._mitsuba
        # a camera of Mitsuba's has x to the left and y up
        pose = np.linalg.inv(camera.world_to_camera.double().numpy()) @ np.diag([-1.0, -1.0, 1.0, 1.0])
        focal = float(camera.intrinsics[0, 0])
        sensor = {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f(pose.tolist()),
            "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * focal)))),
            "fov_axis": "x",
            "near_clip": 1e-3,
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}},
            "sampler": sampler,
        }
        return mi.load_dict(sensor)

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
