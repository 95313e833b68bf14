"""PathTraced: a toy scene's pictures by Mitsuba, with all the light that our own renderer leaves out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from ..errors import DatasetError
from ..formats.srgb import to_srgb
from .shapes import tessellate
from .world import Array, Part

VARIANT = "scalar_rgb"  # the one that needs nothing but Mitsuba, and repeats its pictures
DEPTH = 9  # edges of the longest path


class PathTraced:
    """Parts under a sky, as Mitsuba's scene: textured, metals and coats by Fresnel's equations, every bounce of light.

    What `World` bakes and approximates is simulated: shadows of the sun, color that one surface throws on another,
    light that mirrors gather (caustics), reflection that grows toward grazing.

    Raises:
        DatasetError: Mitsuba is not installed.
    """

    def __init__(self, parts: list[Part], sky: Array) -> None:
        self._mitsuba = _imported()
        shapes = {f"part{index}": self._shape(part) for index, part in enumerate(parts)}
        self._scene = self._mitsuba.load_dict({"type": "scene", **shapes, "sky": self._sky(sky)})
        self._integrator = self._mitsuba.load_dict({"type": "path", "max_depth": DEPTH})

    def picture(self, camera: Camera, supersampling: int, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The view [H, W, 3], sRGB: a pixel is its area's mean of linear light, over supersampling² paths."""
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
            "sampler": {"type": "multijitter", "sample_count": supersampling**2},
        }
        light = mi.render(
            self._scene,
            sensor=mi.load_dict(sensor),
            integrator=self._integrator,
            spp=supersampling**2,
            seed=int(rng.integers(2**31)),
        )
        return np.round(255 * to_srgb(np.array(light)[..., :3])).astype(np.uint8)

    def _shape(self, part: Part) -> Any:
        mi = self._mitsuba
        mesh = tessellate(part.shape)
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(self._material(part))
        if part.emission:
            light = {"type": "area", "radiance": self._texture(part.emission * part.albedo)}
            properties["emitter"] = mi.load_dict(light)
        shape = mi.Mesh(
            "part",
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

    def _material(self, part: Part) -> dict[str, Any]:
        """The part's surface, the same from both sides. A roughness is the square root of GGX's alpha."""
        facets = {"distribution": "ggx", "alpha": part.roughness**2} if part.roughness else {}
        rough = "rough" if facets else ""
        if part.metal:
            surface = {"type": f"{rough}conductor", "material": part.metal, **facets}
        elif part.coat:
            color = self._texture(part.albedo)
            surface = {"type": f"{rough}plastic", "int_ior": part.coat, "diffuse_reflectance": color, **facets}
        else:
            surface = {"type": "diffuse", "reflectance": self._texture(part.albedo)}
        return {"type": "twosided", "surface": surface}

    def _texture(self, linear: Array) -> dict[str, Any]:
        bitmap = self._mitsuba.Bitmap(np.ascontiguousarray(linear, dtype=np.float32))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}

    def _sky(self, sky: Array) -> dict[str, Any]:
        """Light from infinity. Mitsuba's panoramas have y up, and their columns run clockwise from +z."""
        mi = self._mitsuba
        bitmap = mi.Bitmap(np.ascontiguousarray(sky[:, ::-1], dtype=np.float32))
        upright = mi.ScalarTransform4f().rotate([0, 0, 1], -90).rotate([1, 0, 0], 90)
        return {"type": "envmap", "bitmap": bitmap, "to_world": upright}


def _imported() -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise DatasetError(
            "this scene is path-traced by Mitsuba, which is not installed: pip install 'envgs-bench[mitsuba]'"
        ) from error
    mitsuba.set_variant(VARIANT)
    return mitsuba
