"""Captures with a COLMAP model, read by pycolmap: text or binary, any perspective or fisheye camera it knows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..consistency.tracks import check_tracks
from ..consistency.twins import check_twins
from ..errors import DatasetError, listed
from ..formats.colmap_model import Model
from ..formats.image_files import ImageFiles
from ..formats.names import PICTURES, visible_files
from ..formats.photograph import Photograph
from ..notes import note
from ..photographs.sidecars import sidecar_files, with_sidecars
from ..settings import parse_dataset_settings, require_folder
from ..source import Source
from .photograph_files import refuse_missing
from .settings import ColmapSettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 7  # raise it with every change that alters a scene


def load_colmap(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A capture: `root` with its images, its model, and what lies beside them.

        images/…         the photographs; subfolders and extensions as in the model
        sparse/0/        cameras, images and points3D, as .bin or .txt; of several beside it the largest
        masks/…          optional, one an image: region `foreground`, white inside
        masks_<name>/…   optional: region <name>
        normals/…        optional, one an image: rgb = 255·(n/2 + 1/2), or float .npy

    Pictures are undistorted to pinhole cameras, then shrunk by area; intrinsics follow the actual sizes.

    Raises:
        DatasetError: anything missing, unreadable or contradictory; the message names the file or key.
    """
    from .capture import cached_capture, make_scene  # with torch, without which files are found

    choice = parse_dataset_settings(ColmapSettings, settings)
    root = choice.root
    require_folder(root)
    images, model = _images(choice), _model(choice)

    def make() -> Scene:
        found, missing = model.photographs(images)
        refuse_missing(choice.missing, len(found) + len(missing), missing, model.folder)
        check_twins(model.folder, model.content)
        check_tracks(model.folder, model.content)
        _note_others(choice, model)
        _note_without_pose(images, found)
        if choice.equalize_exposure:
            from ..photographs.exposure import with_equal_exposure  # with SciPy

            found = with_equal_exposure(found, model.observations(), choice.background)
        return make_scene(choice, with_sidecars(found, root, choice.normals_frame), model.points(), images)

    return cached_capture(choice, VERSION, _files(choice, model), cache_dir, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """What `load_colmap` makes the scene from: the model, the images that it names, their masks and normals."""
    choice = parse_dataset_settings(ColmapSettings, settings)
    return _files(choice, _model(choice))


def photographs_of(settings: Mapping[str, Any], cache_dir: Path) -> list[Photograph]:
    """What `load_colmap` makes its views from, as they were taken."""
    choice = parse_dataset_settings(ColmapSettings, settings)
    return _model(choice).photographs(choice.root / choice.images)[0]


def _files(choice: ColmapSettings, model: Model) -> list[Path]:
    names, images = model.listed_images(), _images(choice)
    files = ImageFiles(images, names, model.folder)
    return [*model.files, *filter(None, map(files.find, names)), *sidecar_files(names, choice.root)]


def _images(choice: ColmapSettings) -> Path:
    images = choice.root / choice.images
    if not images.is_dir():
        raise DatasetError(
            f"{choice.root}: has no folder {choice.images}/; name the images' folder with dataset.images=…"
        )
    return images


def _model(choice: ColmapSettings) -> Model:
    if choice.model is None:
        parts = _parts(choice)
        if parts:
            return max(parts, key=lambda model: len(model.listed_images())) if len(parts) > 1 else parts[0]
    wanted = choice.model or "sparse"
    model = Model(choice.root / wanted)
    if model.exists:
        return model
    raise DatasetError(
        f"{choice.root}: no COLMAP model in {choice.model or 'sparse/0 or sparse'} (cameras, images and points3D, as "
        ".bin or .txt); name its folder with dataset.model=…"
    )


def _parts(choice: ColmapSettings) -> list[Model]:
    """The models that structure from motion leaves of images that it cannot join, sparse/0 first."""
    folders = [path for path in (choice.root / "sparse").glob("*") if path.name.isdecimal()]
    return [model for path in sorted(folders, key=lambda path: int(path.name)) if (model := Model(path)).exists]


def _note_others(choice: ColmapSettings, taken: Model) -> None:
    """A model that lies beside sparse/0 and is larger is taken in its place, which its user may not expect."""
    parts = _parts(choice)
    if choice.model is None and len(parts) > 1 and taken.folder != parts[0].folder:
        sizes = [f"sparse/{model.folder.name} {len(model.listed_images())}" for model in parts]
        note(
            f"{taken.folder}: taken, the largest of {len(parts)} models (images: {listed(sizes)}). For another "
            f"give its folder, as dataset.model=sparse/{parts[0].folder.name}"
        )


def _note_without_pose(images: Path, photographs: list[Photograph]) -> None:
    """Structure from motion leaves out images that it cannot place; that there are some is worth knowing."""
    used = {photograph.path for photograph in photographs}
    others = [path.name for path in visible_files(images) if path not in used and path.suffix.lower() in PICTURES]
    if others:
        note(f"{images}: {len(others)} images have no pose in the model and are left out: {listed(others)}")


SOURCE = Source(load_colmap, files_read, photographs_of=photographs_of, places=True)
