"""Photographs without cameras: structure from motion places them, then they are a capture like any other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DatasetError, listed
from ..formats.colmap_model import Model
from ..formats.names import PICTURES, visible_files
from ..formats.photograph import Photograph
from ..formats.pictures import read_picture
from ..notes import note
from ..photographs.sidecars import sidecar_files, with_sidecars
from ..progress import mapped
from ..settings import MIN_IMAGES, parse_dataset_settings, require_folder
from ..source import Source
from ..store.contents import digest_of
from .settings import PhotosSettings

if TYPE_CHECKING:
    from envgs_bench.core import Scene

VERSION = 6  # raise it with every change that alters a scene
MODEL_VERSION = 1  # and this with every change that alters a reconstruction


def load_photos(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A folder of photographs: features, matches and pycolmap's incremental mapping give cameras and points.

    The model is kept in the cache, under `models/`; the log says how many images were placed.

    Raises:
        DatasetError: too few images, some that cannot be decoded, too few that could be placed, or a matcher whose
            weights cannot be had.
    """
    from .capture import cached_capture, make_scene  # with torch, without which files are found

    choice = parse_dataset_settings(PhotosSettings, settings)
    require_folder(choice.root)
    images, _ = _images(choice)

    def make() -> Scene:
        model = model_of(settings, cache_dir)
        found, _ = model.photographs(images)
        if choice.equalize_exposure:
            from ..photographs.exposure import with_equal_exposure  # with SciPy

            found = with_equal_exposure(found, model.observations(), choice.background)
        photographs = with_sidecars(found, choice.root, choice.normals_frame)
        return make_scene(choice, photographs, model.points(), images)

    return cached_capture(choice, VERSION, files_read(settings), cache_dir, make)


def files_read(settings: Mapping[str, Any]) -> list[Path]:
    """What `load_photos` makes the scene from: the images, their masks and normals."""
    choice = parse_dataset_settings(PhotosSettings, settings)
    images, names = _images(choice)
    return [*(images / name for name in names), *sidecar_files(names, choice.root)]


def photographs_of(settings: Mapping[str, Any], cache_dir: Path) -> list[Photograph]:
    """What `load_photos` makes its views from, as they were taken."""
    choice = parse_dataset_settings(PhotosSettings, settings)
    images, names = _images(choice)
    return _model(choice, images, names, cache_dir).photographs(images)[0]


def model_of(settings: Mapping[str, Any], cache_dir: Path) -> Model:
    """Cameras, poses and points of these photographs, from the cache or made now; raises as `load_photos`."""
    choice = parse_dataset_settings(PhotosSettings, settings)
    require_folder(choice.root)
    images, names = _images(choice)
    model = _model(choice, images, names, cache_dir)
    _judge(choice, images, names, model.image_names)
    return model


def _images(choice: PhotosSettings) -> tuple[Path, list[str]]:
    """The images' folder, and its images' paths below it, in their order; below `root` itself, subfolders do not count.

    Raises:
        DatasetError: there is no such folder, or too few images in it.
    """
    root = choice.root
    folder = root / (choice.images or ("images" if (root / "images").is_dir() else "."))
    if not folder.is_dir():
        raise DatasetError(f"{root}: has no folder {choice.images}/; name the images' folder with dataset.images=…")
    below = visible_files(folder, deep=folder.resolve() != root.resolve())
    files = [path for path in below if path.suffix.lower() in PICTURES]
    if len(files) < MIN_IMAGES:
        raise DatasetError(
            f"{folder}: holds {len(files)} images, expected {MIN_IMAGES} at least, and better 20 or more; known are "
            f"{', '.join(PICTURES)}"
        )
    return folder, [path.relative_to(folder).as_posix() for path in files]


def _model(choice: PhotosSettings, images: Path, names: Sequence[str], cache_dir: Path) -> Model:
    """The images' model, from the cache or made now."""
    from ..photographs.reconstruction import Reconstructor

    _check_decodable([images / name for name in names], choice)
    contents = digest_of([images / name for name in names], choice.root, cache_dir)
    how = Reconstructor(choice.matcher, choice.camera_model, choice.matching, choice.feature_size)
    settings = f"{choice.matcher}-{choice.camera_model}-{choice.matching}-{choice.feature_size}"
    label = f"{settings}-{MODEL_VERSION}-{contents[:16]}"
    return how.model_of(names, images, cache_dir / "models" / label.lower())


def _check_decodable(files: Sequence[Path], choice: PhotosSettings) -> None:
    """Structure from motion leaves out what it cannot read; the user would rather know. Keeps no picture."""

    def check(path: Path) -> None:
        read_picture(path, choice.background)

    mapped("checking images", check, files)


def _judge(choice: PhotosSettings, images: Path, names: Sequence[str], placed: Sequence[str]) -> None:
    share = len(placed) / len(names)
    text = f"{images}: structure from motion placed {len(placed)} of {len(names)} images"
    left_out = sorted(set(names) - set(placed))
    if share < choice.min_registered:
        raise DatasetError(
            f"{text}, fewer than dataset.min_registered={choice.min_registered:g} asks for; not placed: "
            f"{listed(left_out)}. Take more that overlap and show texture, try dataset.matching=exhaustive or a larger "
            "dataset.feature_size, or lower dataset.min_registered"
        )
    note(f"{text}; left out: {listed(left_out)}" if left_out else text)


SOURCE = Source(load_photos, files_read, photographs_of=photographs_of, model_of=model_of, places=True)
