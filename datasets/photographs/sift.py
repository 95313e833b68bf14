"""SIFT: features and matches by pycolmap, put into its database."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pycolmap


class Sift:
    """A `reconstruction.Matcher` on images reduced to `feature_size` pixels along their longer side."""

    pairs_a_batch = 64

    def __init__(self, feature_size: int) -> None:
        self.extraction = pycolmap.FeatureExtractionOptions()
        self.extraction.max_image_size = feature_size

    def find_features(
        self, database: Path, images: Path, names: Sequence[str], reader: pycolmap.ImageReaderOptions
    ) -> None:
        pycolmap.extract_features(database, images, names, pycolmap.CameraMode.SINGLE, reader, self.extraction)

    def match(
        self,
        database: Path,
        pairs: Sequence[tuple[str, str]],
        listing: Path,
        verification: pycolmap.TwoViewGeometryOptions,
    ) -> None:
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listing
        pycolmap.match_image_pairs(database, pycolmap.FeatureMatchingOptions(), pairing, verification)
