"""Siblings: masks and normals in folders beside the images, found by the images' names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from ..errors import DatasetError, listed


class Siblings:
    """Files of a folder, found by an image's name: the same path below the folder, with any extension."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
        self._paths = {path.relative_to(folder).with_suffix("").as_posix(): path for path in self.files}

    def find(self, image_name: str) -> Path | None:
        """The file for image `a/b.jpg`: `a/b.<any>` or, as COLMAP names masks, `a/b.jpg.<any>`; None without one."""
        stem = PurePosixPath(image_name).with_suffix("").as_posix()
        return self._paths.get(stem) or self._paths.get(image_name)

    def find_all(self, image_names: Iterable[str]) -> list[Path]:
        """The files for these images, in their order.

        Raises:
            DatasetError: there is none for some image, and a mean over the few views that happen to have one would be
                another number; or there are several for one, as a preview beside an array.
        """
        if len(self._paths) < len(self.files):
            others = sorted(path.name for path in set(self.files) - set(self._paths.values()))
            raise DatasetError(
                f"{self.folder}: holds several files of one name, of which one image needs one: {listed(others)}; "
                "move away those that are not meant"
            )
        names = list(image_names)
        found = [self.find(name) for name in names]
        missing = [name for name, path in zip(names, found, strict=True) if path is None]
        if missing:
            raise DatasetError(
                f"{self.folder}: holds no file for {len(missing)} of {len(names)} images: {listed(missing)}; "
                "add them, or move the folder away"
            )
        return [path for path in found if path is not None]


def region_folders(root: Path) -> dict[str, Path]:
    """Regions by name, each a folder of masks: `masks/` is `foreground`, `masks_<region>/` is <region>."""
    folders = {"foreground": root / "masks"}
    folders |= {path.name.removeprefix("masks_"): path for path in sorted(root.glob("masks_?*"))}
    return {region: path for region, path in folders.items() if path.is_dir()}
