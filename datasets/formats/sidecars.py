"""Sidecars: masks and normals in folders beside the images, found by the images' names."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from ..errors import DatasetError, listed
from .mask_file import mask_size
from .names import EXTENSIONS, composed, stem_of, visible_files


class Sidecars:
    """Files of a folder, found by an image's name: the same path below the folder, with any extension of theirs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = [path for path in visible_files(folder) if path.suffix.lower() in EXTENSIONS]
        self._paths: dict[str, list[Path]] = defaultdict(list)
        for path in self.files:
            self._paths[composed(stem_of(path.relative_to(folder).as_posix()))].append(path)

    def candidates(self, image_name: str) -> list[Path]:
        """The files for image `a/b.jpg`: `a/b.<any>` and, as COLMAP names masks, `a/b.jpg.<any>`."""
        names = dict.fromkeys((composed(stem_of(image_name)), composed(image_name)))
        return [path for name in names for path in self._paths.get(name, [])]

    def find_all(self, image_names: Iterable[str]) -> list[Path]:
        """The files for these images, in their order.

        Raises:
            DatasetError: there is none for some image, and a mean over the few views that happen to have one would be
                another number; or there are several for one, as a preview beside an array.
        """
        names = list(image_names)
        found = [self.candidates(name) for name in names]
        several = sorted({path.name for paths in found if len(paths) > 1 for path in paths})
        if several:
            raise DatasetError(
                f"{self.folder}: holds several files of one name, of which one image needs one: {listed(several)}; "
                "move away those that are not meant"
            )
        missing = [name for name, paths in zip(names, found, strict=True) if not paths]
        if missing:
            raise DatasetError(
                f"{self.folder}: holds no file for {len(missing)} of {len(names)} images: {listed(missing)}; "
                "add them, or move the folder away"
            )
        return [paths[0] for paths in found]


def region_folders(root: Path) -> dict[str, Path]:
    """Regions by name, each a folder of masks: `masks/` is `foreground`, `masks_<region>/` is <region>.

    `masks_2/` beside `masks/`, and `masks_<region>_2/` beside `masks_<region>/`, are no regions but reduced copies.

    Raises:
        DatasetError: a folder is called as a reduced copy of masks, and is none.
    """
    found = [path for path in [root / "masks", *sorted(root.glob("masks_?*"))] if path.is_dir()]
    regions = [path for path in found if not _is_reduced_copy(path)]
    return {"foreground" if path.name == "masks" else path.name.removeprefix("masks_"): path for path in regions}


def _is_reduced_copy(folder: Path) -> bool:
    base, _, factor = folder.name.rpartition("_")
    if not factor.isdecimal():
        return False
    whole = folder.with_name(base)
    if not whole.is_dir():
        if base != "masks":
            return False
        raise DatasetError(
            f"{folder}: is called as a reduced copy of {whole.name}/, which is not there; rename it to masks/, or to "
            "masks_<region>/"
        )
    copies = Sidecars(folder)
    pairs = [(path, found[0]) for path in Sidecars(whole).files if (found := copies.candidates(path.name))]
    reduced = not pairs or mask_size(pairs[0][1]) < mask_size(pairs[0][0])
    if base == "masks" and not reduced:
        raise DatasetError(
            f"{folder}: is called as a copy of {whole.name}/ reduced {factor} times, and is of its size; rename "
            "it to masks_<region>/, or move it away"
        )
    return reduced
