"""LightGlue on DISK features: learned features and matches by kornia, put into pycolmap's database.

DISK: Tyszkiewicz, Fua, Trulls, NeurIPS 2020. LightGlue: Lindenberger, Sarlin, Pollefeys, ICCV 2023.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..errors import DatasetError
from ..formats.pictures import read_picture
from .resampling import resample

KEYPOINTS = 2048  # an image, at most: the time of matching two grows with its square
WEIGHTS = {  # files' names in torch.hub's cache, as kornia looks for them, and where their authors offer them
    "depth-save.pth": "https://raw.githubusercontent.com/cvlab-epfl/disk/master/depth-save.pth",
    "disk_lightglue_v0-1_arxiv-pth": "https://github.com/cvg/LightGlue/releases/download/v0.1_arxiv/disk_lightglue.pth",
}


@dataclass(frozen=True)
class Features:
    """What was found in one image, on the CPU."""

    image_id: int  # in the database
    keypoints: Tensor  # [N, 2]: x, y in pixels of the reduced image, whole numbers at their centers
    descriptors: Tensor  # [N, D], of length 1
    size: tuple[int, int]  # width and height of the reduced image


class LightGlue:
    """A `reconstruction.Matcher` on images reduced to `feature_size` pixels along their longer side.

    On the GPU where there is one. The features of all images are kept, KEYPOINTS·D floats each (1 MB).

    Raises:
        DatasetError: the networks' weights cannot be had; later, pycolmap cannot read an image.
    """

    pairs_a_batch = 8

    def __init__(self, feature_size: int) -> None:
        self.feature_size = feature_size
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.detector, self.matcher = (network.to(self.device).eval() for network in _networks())
        self.features: dict[str, Features] = {}

    def find_features(
        self, database: Path, images: Path, names: Sequence[str], reader: pycolmap.ImageReaderOptions
    ) -> None:
        pycolmap.Database.open(database).close()  # makes it
        pycolmap.import_images(database, images, pycolmap.CameraMode.SINGLE, names, reader)
        with pycolmap.Database.open(database) as opened:
            for name in names:
                image = opened.read_image_with_name(name)
                if image is None:
                    raise DatasetError(f"{(images / name).resolve()}: pycolmap cannot read it; save it as PNG or JPEG")
                pixels, _ = read_picture(images / name, (0.0, 0.0, 0.0))
                found = self._features(pixels, image.image_id)
                self.features[name] = found
                height, width, _ = pixels.shape
                scale = np.array([width / found.size[0], height / found.size[1]])
                # COLMAP counts from the image's corner, where the first pixel's center is 0.5.
                opened.write_keypoints(found.image_id, ((found.keypoints.numpy() + 0.5) * scale).astype(np.float32))

    def match(
        self,
        database: Path,
        pairs: Sequence[tuple[str, str]],
        listing: Path,
        verification: pycolmap.TwoViewGeometryOptions,
    ) -> None:
        with pycolmap.Database.open(database) as opened:
            for pair in pairs:
                first, second = (self.features[name] for name in pair)
                opened.write_matches(first.image_id, second.image_id, self._matches(first, second))
        pycolmap.verify_matches(database, listing, verification)

    @torch.inference_mode()
    def _features(self, pixels: NDArray[np.uint8], image_id: int) -> Features:
        """Of a picture [H, W, 3]."""
        height, width, _ = pixels.shape
        scale = min(1.0, self.feature_size / max(width, height))
        width, height = max(1, round(scale * width)), max(1, round(scale * height))
        picture = torch.from_numpy(resample(pixels, width, height) / 255).permute(2, 0, 1)[None].to(self.device)
        (found,) = self.detector(picture, n=KEYPOINTS, pad_if_not_divisible=True)
        return Features(image_id, found.keypoints.cpu(), found.descriptors.cpu(), (width, height))

    @torch.inference_mode()
    def _matches(self, first: Features, second: Features) -> NDArray[np.uint32]:
        """[M, 2]: indices of keypoints of the one and the other image that show the same point."""
        if min(len(first.keypoints), len(second.keypoints)) < 2:  # what no transformer was trained on
            return np.zeros((0, 2), dtype=np.uint32)
        given = {
            name: {
                "keypoints": features.keypoints[None].to(self.device),
                "descriptors": features.descriptors[None].to(self.device),
                "image_size": torch.tensor([features.size], device=self.device),
            }
            for name, features in (("image0", first), ("image1", second))
        }
        return self.matcher(given)["matches"][0].cpu().numpy().astype(np.uint32)


def _networks() -> tuple[nn.Module, nn.Module]:
    """DISK and LightGlue with their authors' weights, which kornia downloads where torch.hub's cache lacks them.

    Raises:
        DatasetError: they could not be downloaded, or a file holds something else.
    """
    from kornia.feature import DISK, LightGlue  # takes a second, and few need it

    try:
        with torch.random.fork_rng(devices=()):  # networks draw weights before they read them: no one's numbers change
            detector, matcher = DISK.from_pretrained("depth"), LightGlue("disk")
        if matcher.training:  # kornia's sign of weights that the file lacks, which would be random now
            raise RuntimeError("weights are missing from LightGlue's file")
    except (OSError, RuntimeError, KeyError) as error:
        folder = Path(torch.hub.get_dir()) / "checkpoints"
        by_hand = "; ".join(
            f"{url} as {folder / name}{' (a file is there)' if (folder / name).is_file() else ''}"
            for name, url in WEIGHTS.items()
        )
        raise DatasetError(
            "dataset.matcher=lightglue needs the weights of DISK and LightGlue, which could not be loaded "
            f"({error}). Where this machine has no access to them, put there by hand: {by_hand}; or set "
            "dataset.matcher=sift"
        ) from error
    return detector, matcher
