"""Reconstruction: points of photographs, and their cameras where these are not known, by structure from motion."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Protocol

import numpy as np
import pycolmap

from ..errors import DatasetError
from ..formats.colmap_model import Model
from ..formats.photograph import Photograph
from ..formats.pictures import read_header
from ..placing import origin_near
from ..progress import report
from ..settings import MIN_IMAGES, MatcherName, Matching
from .kept_model import kept_model
from .lightglue import LightGlue
from .placing import sights_of
from .sift import Sift

IMAGES_A_BATCH = 8  # between two reports of progress
NEIGHBORS = 10  # each image is matched with this many after it, and with those 2, 4, 8 … away
SEED = 0


class Matcher(Protocol):
    """Finds features in images, and which of them show the same point."""

    pairs_a_batch: int  # between two reports of progress

    def find_features(
        self, database: Path, images: Path, names: Sequence[str], reader: pycolmap.ImageReaderOptions
    ) -> None:
        """Put the images and their features into the database; they share the camera that `reader` says."""

    def match(
        self,
        database: Path,
        pairs: Sequence[tuple[str, str]],
        listing: Path,
        verification: pycolmap.TwoViewGeometryOptions,
    ) -> None:
        """Put these pairs' matches into the database, and those that fit one motion; `listing` names the pairs."""


MATCHERS: dict[MatcherName, Callable[[int], Matcher]] = {"sift": Sift, "lightglue": LightGlue}


@dataclass(frozen=True)
class Reconstructor:
    """How photographs become a model.

    Attributes:
        matcher: what finds features and matches them.
        camera_model: COLMAP's name; images of one size share a camera.
        matching: every image with every other, or with its neighbors in the order of names.
        feature_size: images are reduced to this many pixels along their longer side for finding features.
    """

    matcher: MatcherName
    camera_model: str
    matching: Matching
    feature_size: int

    def model_of(self, names: Sequence[str], images: Path, folder: Path) -> Model:
        """The model of the images `images/<name>`, in `folder`, made unless it is there as it was written.

        Of several models, which share no points, the one that places the most images.

        Raises:
            DatasetError: no two images could be placed, or the matcher's weights cannot be had.
        """

        def make(work: Path) -> pycolmap.Reconstruction:
            by_size: dict[tuple[int, int], list[str]] = defaultdict(list)
            for name in names:
                header = read_header(images / name)
                by_size[header.width, header.height].append(name)
            readers = [(_reader(self.camera_model), alike) for alike in by_size.values()]
            self._find_and_match({name: images / name for name in names}, readers, work)
            return self._map(names, images, work)

        return kept_model(folder, make)

    def triangulated(self, photographs: Sequence[Photograph], folder: Path) -> Model:
        """As `model_of`, of photographs whose cameras and poses are known and stay as they are: only points are found.

        Args:
            photographs: fitted to their files (`fit_to_files`), none of them turned.

        Raises:
            DatasetError: no point is seen by two of them, or the matcher's weights cannot be had.
        """

        def make(work: Path) -> pycolmap.Reconstruction:
            by_camera: dict[str, list[Photograph]] = defaultdict(list)
            for photograph in photographs:
                by_camera[photograph.camera_id].append(photograph)
            readers = [(_reader_of(alike[0].camera), [p.name for p in alike]) for alike in by_camera.values()]
            self._find_and_match({p.name: p.path for p in photographs}, readers, work)
            return _triangulate(photographs, work)

        return kept_model(folder, make)

    def _find_and_match(
        self, files: Mapping[str, Path], readers: Sequence[tuple[pycolmap.ImageReaderOptions, list[str]]], work: Path
    ) -> None:
        """Fill the database with features and matches of these files; each reader's share a camera."""
        matcher = MATCHERS[self.matcher](self.feature_size)
        (work / "images").mkdir()
        plain = _plain_names(files)
        for name, path in files.items():
            (work / "images" / plain[name]).symlink_to(path.resolve())
        done = 0
        for reader, names in readers:
            for batch in _batches([plain[name] for name in names], IMAGES_A_BATCH):
                matcher.find_features(work / "database.db", work / "images", batch, reader)
                if reader.existing_camera_id < 0:
                    reader.existing_camera_id = _newest_camera(work / "database.db")
                done += len(batch)
                report("finding features", done, len(files))
        self._match(matcher, list(plain.values()), work)

    def _match(self, matcher: Matcher, names: Sequence[str], work: Path) -> None:
        pairs = list(combinations(names, 2)) if self.matching == "exhaustive" else list(_neighbors(names))
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = SEED
        done = 0
        for batch in _batches(pairs, matcher.pairs_a_batch):
            (work / "pairs.txt").write_text("".join(f"{first} {second}\n" for first, second in batch))
            matcher.match(work / "database.db", batch, work / "pairs.txt", verification)
            done += len(batch)
            report("matching images", done, len(pairs))

    def _map(self, names: Sequence[str], images: Path, work: Path) -> pycolmap.Reconstruction:
        options = pycolmap.IncrementalPipelineOptions()
        options.min_model_size, options.random_seed = MIN_IMAGES, SEED
        placed = 0

        def started() -> None:
            nonlocal placed
            placed = 2
            report("placing images", placed, len(names))

        def added() -> None:
            nonlocal placed
            placed += 1
            report("placing images", placed, len(names))

        (work / "models").mkdir()
        models = pycolmap.incremental_mapping(
            work / "database.db", work / "images", work / "models", options, "", started, added
        )
        if not models:
            raise DatasetError(
                f"{images}: structure from motion placed none of {len(names)} images: no two of them share enough; "
                "they should overlap by more than half and show texture"
            )
        best = max(models.values(), key=lambda model: model.num_reg_images())
        return _named(best, names)


def _triangulate(photographs: Sequence[Photograph], work: Path) -> pycolmap.Reconstruction:
    """Points for the matches in the database, seen from where the photographs were taken.

    Far from the origin triangulation loses more digits than float64 has: it is done near the origin.
    """
    model = pycolmap.Reconstruction()
    plain = _plain_names(photograph.name for photograph in photographs)
    placement = origin_near(sights_of(photographs))
    poses = {plain[p.name]: placement.pose_from_data(p.world_to_camera)[:3] for p in photographs}
    with pycolmap.Database.open(work / "database.db") as opened:
        for camera in opened.read_all_cameras():
            model.add_camera_with_trivial_rig(camera)
        for image in opened.read_all_images():
            placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            model.add_image_with_trivial_frame(placed, pycolmap.Rigid3d(poses[image.name]))
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = SEED
    (work / "models").mkdir()
    report("finding points", 0, 1)
    pycolmap.triangulate_points(model, work / "database.db", work / "images", work / "models", options=options)
    if not model.num_points3D():
        raise DatasetError(
            f"{photographs[0].path.parent}: {len(photographs)} images share no point that fits their poses; check "
            "these, their axes first"
        )
    if not placement.unmoved:
        model.transform(pycolmap.Sim3d(1, pycolmap.Rotation3d(), np.array(placement.shift)))
    return _named(model, list(plain))


def _named(model: pycolmap.Reconstruction, names: Sequence[str]) -> pycolmap.Reconstruction:
    """The model with its images called as they were before they got plain names."""
    original = {plain: name for name, plain in _plain_names(names).items()}
    for image in model.images.values():
        image.name = original[image.name]
    return model


def _reader(camera_model: str) -> pycolmap.ImageReaderOptions:
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = camera_model
    return reader


def _reader_of(camera: pycolmap.Camera) -> pycolmap.ImageReaderOptions:
    """One that knows the camera."""
    reader = _reader(camera.model.name)
    reader.camera_params = ",".join(map(repr, map(float, camera.params)))
    return reader


def _plain_names(names: Iterable[str]) -> dict[str, str]:
    """By name one that no list of pairs can break."""
    return {name: f"{index:06d}{Path(name).suffix}" for index, name in enumerate(names)}


def _neighbors(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Pairs of a sequence: near ones, and far ones at distances of powers of two."""
    distances = {*range(1, NEIGHBORS + 1), *(2**power for power in range(len(names).bit_length()))}
    return ((names[i], names[i + d]) for d in sorted(distances) for i in range(len(names) - d))


def _batches(items: Sequence, size: int) -> Iterator[Sequence]:
    return (items[first : first + size] for first in range(0, len(items), size))


def _newest_camera(database: Path) -> int:
    with pycolmap.Database.open(database) as opened:
        return max(camera.camera_id for camera in opened.read_all_cameras())
