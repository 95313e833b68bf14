"""Settings of the sources of pictures on disk; they import neither torch nor pycolmap, as runs are composed without."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ..settings import Frame, MatcherName, Matching, SourceSettings

Channel = Annotated[float, Field(ge=0, le=1)]
MaskLabel = int | Annotated[str, Field(pattern="^#[0-9a-fA-F]{6}$")]  # a number, or a color
Missing = Literal["refuse", "skip"]


class CaptureSettings(SourceSettings):
    """Settings of every source of photographs."""

    root: Path
    downsample: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 1.0  # pictures are this many times smaller
    background: tuple[Channel, Channel, Channel] = (0.0, 0.0, 0.0)  # sRGB
    mask_labels: tuple[MaskLabel, ...] = ()  # those inside, where masks hold more than two values
    normal_estimator: str | None = None  # package.module:function, for the training views

    @property
    def scene_name(self) -> str:
        return self.name or self.root.resolve().name


class PhotographSettings(CaptureSettings):
    """Settings of the sources whose views share one list, with masks and normals in folders beside them."""

    exact_normals: bool = False  # whether normals/ hold the truth, to which test views are held, or a guess
    far_points: Annotated[int, Field(ge=0)] = 0  # added on a sphere around the cameras, to start a background from


class ColmapSettings(PhotographSettings):
    """Settings of `kind: colmap`."""

    kind: Literal["colmap"]
    equalize_exposure: bool = False  # undo automatic exposure and white balance, as estimated from the points
    images: str = "images"  # folder below root
    missing: Missing = "refuse"  # images of the model that are not there
    model: str | None = None  # folder below root; the largest of sparse/0, sparse/1 …, or else sparse, where None
    normals_frame: Frame = "world"  # axes of normals/; camera: right, down, forward; opengl: right, up, backward


class BlenderSettings(CaptureSettings):
    """Settings of `kind: blender`."""

    kind: Literal["blender"]
    background: tuple[Channel, Channel, Channel] = (1.0, 1.0, 1.0)  # sRGB
    missing: Missing = "refuse"  # images that the files name and that are not there
    random_points: Annotated[int, Field(ge=1)] = 100_000  # how many to start from without points3d.ply
    random_box: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = (
        None  # half the edge of their cube; None: 1.3, or as much beside the cameras' distance in a world that is moved
    )
    train_normals: bool = False  # learn from exact normals too, where there are any; scores always refer to them


class TransformsSettings(PhotographSettings):
    """Settings of `kind: transforms`."""

    kind: Literal["transforms"]
    file: str = "transforms.json"  # below root
    missing: Missing = "refuse"  # images that the file names and that are not there
    images: str | None = None  # folder below root in place of the first one in each file_path, as images_4
    normals_frame: Frame = "world"  # axes of normals/; camera: right, down, forward; opengl: right, up, backward
    random_points: Annotated[int, Field(ge=1)] = 100_000  # how many to start from where the file names no point cloud
    random_box: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = (
        None  # half the edge of the cube that random points fill; None: from aabb_scale
    )


class PhotosSettings(PhotographSettings):
    """Settings of `kind: photos`."""

    kind: Literal["photos"]
    equalize_exposure: bool = False  # undo automatic exposure and white balance, as estimated from the points
    images: str | None = None  # folder below root; images/ where there is one, else root itself, where None
    matcher: MatcherName = "sift"  # lightglue: learned, for what shines or has little texture; needs weights
    matching: Matching = "exhaustive"  # sequential: with neighbors in the order of names, as for a video's frames
    camera_model: Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"] = "OPENCV"
    feature_size: Annotated[int, Field(ge=100)] = 1600  # pixels along the longer side, for finding features
    min_registered: Annotated[float, Field(gt=0, le=1)] = 0.5  # share of the images that must be placed
    normals_frame: Frame = "camera"  # axes of normals/; camera: right, down, forward; opengl: right, up, backward


SETTINGS: dict[str, type[SourceSettings]] = {  # kind -> its settings; the source is the file of the same name
    "colmap": ColmapSettings,
    "blender": BlenderSettings,
    "transforms": TransformsSettings,
    "photos": PhotosSettings,
}
