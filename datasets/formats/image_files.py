"""Image files: the picture of each name that a file of poses gives, its own or none."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..errors import DatasetError, listed
from ..notes import note
from .names import PICTURES, clean_name, composed, path_below, stem_of, visible_files


class ImageFiles:
    """The pictures below a folder, by the names that `source`, a file or folder, gives all of them.

    A name's file may have another extension, as after a conversion, or one where the name has none: if it is the only
    such file, and is not what another name means.
    """

    def __init__(self, folder: Path, names: Iterable[str], source: Path) -> None:
        self.folder, self.source = folder, source
        self._named = {composed(clean_name(name, source)) for name in names}
        self._in: dict[Path, list[Path]] = {}
        self._converted: list[str] = []

    def find(self, name: str) -> Path | None:
        """The name's file; None where there is none.

        Raises:
            DatasetError: the name leaves the folder, or several files could be meant.
        """
        path = path_below(self.folder, name, self.source)
        if path.is_file():
            return path
        stem = stem_of(path.name)
        if path.parent not in self._in:
            self._in[path.parent] = visible_files(path.parent, deep=False) if path.parent.is_dir() else []
        alike = [other for other in self._in[path.parent] if self._stands_in(other, stem)]
        if len(alike) > 1:
            raise DatasetError(
                f"{self.source}: names the image {name}, which is not there, and several files could be meant: "
                f"{listed([other.name for other in alike])}; leave one of them"
            )
        if alike and stem != path.name:
            self._converted.append(name)
        return alike[0] if alike else None

    def note_converted(self) -> None:
        """Note names whose files were found with another extension."""
        if self._converted:
            note(
                f"{self.source}: {len(self._converted)} images were taken from files with another extension than it "
                f"names: {listed(self._converted)}"
            )

    def _stands_in(self, other: Path, stem: str) -> bool:
        place = composed(other.relative_to(self.folder).as_posix())
        same = composed(stem_of(other.name)) == composed(stem)
        return same and other.suffix.lower() in PICTURES and place not in self._named
