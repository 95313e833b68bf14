"""ToySettings: what a toy scene is made from."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from ..settings import Edge, SourceSettings, not_too_tall

RayTraced = Literal[
    "chrome_room",
    "sky_ball",
    "diffuse_room",
    "lacquered_table",
    "facing_mirrors",
    "glass",
    "wavy_mirror",
    "thin_rails",
]
PathTraced = Literal["copper_table", "brushed_patio"]  # by Mitsuba, which takes minutes
PRESETS = {"toy": get_args(RayTraced), "path_traced": get_args(PathTraced)}  # what each scene's preset begins with


class ToySettings(SourceSettings):
    """Settings of `kind: toy`."""

    kind: Literal["toy"]
    scene: Literal[RayTraced, PathTraced]
    width: Edge = 160  # pixels
    height: Annotated[Edge, Field(validate_default=True), AfterValidator(not_too_tall)] = 120
    views: Annotated[int, Field(ge=2)] = 48  # training and test views together
    unseen: Annotated[int, Field(ge=0)] = 0  # views between the training cameras, and as many beyond them
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.01  # standard deviation of the points' positions, m
    normal_noise: Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)] = 0.0  # mean angle of training views, °
    seed: Annotated[int, Field(ge=0)] = 0  # for textures, sky, light, pixels, points and normals
    supersampling: Annotated[int, Field(ge=1)] = 3  # rays along each side of a pixel
    tracer: Literal["cpu", "gpu"] = "cpu"  # where Mitsuba traces pictures; but for noise they are the same

    @field_validator("tracer")
    @classmethod
    def _traces_paths(cls, tracer: str, info: ValidationInfo) -> str:
        scene = info.data.get("scene")
        if tracer == "gpu" and scene in PRESETS["toy"]:
            raise ValueError(
                f"{scene} is ray-traced, which the CPU alone does; give dataset.tracer=cpu, or a scene that is "
                f"path-traced: {', '.join(PRESETS['path_traced'])}"
            )
        return tracer
