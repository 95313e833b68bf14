"""Reconstruction: cameras and points from photographs alone, by pycolmap's structure from motion."""

from __future__ import annotations

import json
import shutil
import uuid
import warnings
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, Protocol

import pycolmap

from ..errors import DatasetError
from ..formats.colmap_model import Model
from ..formats.pictures import read_header
from ..progress import report
from .lightglue import LightGlue
from .sift import Sift

Matching = Literal["exhaustive", "sequential"]
MatcherName = Literal["sift", "lightglue"]

IMAGES_A_BATCH = 8  # between two reports of progress
NEIGHBORS = 10  # each image is matched with this many after it, and with those 2, 4, 8 … away
MIN_IMAGES = 3  # images that a model must place
SEED = 0
CHECKSUMS = "checksums.json"  # of the model's files, beside them


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
        if folder.is_dir():
            if _checksums(folder) == _remembered(folder):
                return Model(folder)
            warnings.warn(f"{folder} is damaged: it is not what was written; it is made again", stacklevel=2)
            shutil.rmtree(folder)
        matcher = MATCHERS[self.matcher](self.feature_size)
        work = folder.with_name(f"{folder.name}-{uuid.uuid4().hex}.part")
        try:
            (work / "images").mkdir(parents=True)
            for index, name in enumerate(names):  # under names that no list of pairs can break
                (work / "images" / _plain(index, name)).symlink_to((images / name).resolve())
            with _quiet():
                self._find_features(matcher, names, images, work)
                self._match(matcher, names, work)
                model = self._map(names, images, work)
            (work / "model").mkdir()
            model.write_binary(str(work / "model"))
            (work / "model" / CHECKSUMS).write_text(json.dumps(_checksums(work / "model")), encoding="utf-8")
            try:
                (work / "model").rename(folder)
            except OSError:
                if not folder.is_dir():  # else another process has made it meanwhile
                    raise
        finally:
            shutil.rmtree(work, ignore_errors=True)
        return Model(folder)

    def _find_features(self, matcher: Matcher, names: Sequence[str], images: Path, work: Path) -> None:
        by_size: dict[tuple[int, int], list[str]] = defaultdict(list)
        for index, name in enumerate(names):
            header = read_header(images / name)
            by_size[header.width, header.height].append(_plain(index, name))
        done = 0
        for plain in by_size.values():
            reader = pycolmap.ImageReaderOptions()
            reader.camera_model = self.camera_model
            for batch in _batches(plain, IMAGES_A_BATCH):
                matcher.find_features(work / "database.db", work / "images", batch, reader)
                if reader.existing_camera_id < 0:
                    reader.existing_camera_id = _newest_camera(work / "database.db")
                done += len(batch)
                report("finding features", done, len(names))

    def _match(self, matcher: Matcher, names: Sequence[str], work: Path) -> None:
        plain = [_plain(index, name) for index, name in enumerate(names)]
        pairs = list(combinations(plain, 2)) if self.matching == "exhaustive" else list(_neighbors(plain))
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
        original = {_plain(index, name): name for index, name in enumerate(names)}
        for image in best.images.values():
            image.name = original[image.name]
        return best


def _checksums(folder: Path) -> dict[str, int]:
    """The CRC-32 of each of the model's files."""
    return {path.name: zlib.crc32(path.read_bytes()) for path in sorted(folder.glob("*.bin")) if path.is_file()}


def _remembered(folder: Path) -> Any:
    try:
        return json.loads((folder / CHECKSUMS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _plain(index: int, name: str) -> str:
    return f"{index:06d}{Path(name).suffix}"


def _neighbors(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Pairs of a sequence: near ones, and far ones at distances of powers of two."""
    distances = {*range(1, NEIGHBORS + 1), *(2**power for power in range(len(names).bit_length()))}
    return ((names[i], names[i + d]) for d in sorted(distances) for i in range(len(names) - d))


def _batches(items: Sequence, size: int) -> Iterator[Sequence]:
    return (items[first : first + size] for first in range(0, len(items), size))


def _newest_camera(database: Path) -> int:
    with pycolmap.Database.open(database) as opened:
        return max(camera.camera_id for camera in opened.read_all_cameras())


@contextmanager
def _quiet() -> Iterator[None]:
    """pycolmap says every step it takes; here only its errors are of interest."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
