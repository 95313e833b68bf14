"""Composes a published data set as a run would, and makes its folder: of an archive, or of photographs of that."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.export.photographs import export_photographs
from envgs_bench.datasets.progress import listening
from envgs_bench.published.fetching import FetchError, fetch
from envgs_bench.published.unpacking import unpack_scene
from envgs_bench.runs.display import make_display

from .composition import composed

ARCHIVES = "downloads"  # the folder of the cache that keeps archives, which hold several scenes


@dataclass(frozen=True)
class Published:
    """Where a data set is to be had, and what is made of it.

    Attributes:
        root: the folder to make.
        url: of an archive; None where there is none.
        obtain: what to do by hand.
        recipe: where the archive holds photographs rather than the folder: `folder` of the archive, `source` to read
            it, `width` of the pictures.
    """

    root: Path
    url: str | None
    obtain: str
    recipe: dict[str, Any] | None
    cache_dir: Path

    @property
    def archives(self) -> Path:
        return self.cache_dir / ARCHIVES

    def make(self, photographs: Path | None, sha256: str | None) -> str:
        """Make the folder, of these photographs or else of the archive; returns what was done."""
        if self.recipe and photographs:
            images = self._from(self.recipe, photographs)
            return f"{self.root}: {images} images and their model, made of {photographs}"
        archive = fetch(self.url or "", self.archives, sha256)
        if not self.recipe:
            files = unpack_scene(archive, self.root)
            return f"{self.root}: {files} files of {archive}, which may be deleted once no other scene of it is wanted"
        with tempfile.TemporaryDirectory(dir=self.archives, prefix=".photographs.") as folder:
            unpacked = Path(folder) / self.recipe["folder"]
            unpack_scene(archive, unpacked)
            images = self._from(self.recipe, unpacked)
        return f"{self.root}: {images} images and their model, made of {archive}, which may be deleted"

    def _from(self, recipe: dict[str, Any], photographs: Path) -> int:
        source = {**recipe["source"], "root": photographs}
        return export_photographs(source, recipe["width"], self.root, self.cache_dir)


def download(name: str, overrides: list[str], photographs: Path | None, sha256: str | None) -> int:
    """Make the folder that `dataset=<name>` reads, unless it is there; returns the exit status, 0.

    Args:
        photographs: the published ones, where this machine has them already; None: they are fetched.
        sha256: what the archive's must be.

    Raises:
        DatasetError: it is not published as one archive, or that cannot be had or unpacked, or nothing can be made of
            the photographs; the message says what to do by hand.
        OSError: the folder or the cache cannot be written.
    """
    settings = composed([f"dataset={name}", *overrides])
    root, url, obtain, recipe = (settings.dataset.get(key) for key in ("root", "download", "obtain", "photographs"))
    if not root:
        raise DatasetError(f"{name}: is made here, and not downloaded: envgs-bench run dataset={name}")
    if photographs and not recipe:
        raise DatasetError(f"{name}: is not made of photographs; for {root}: {obtain or 'your own'}")
    if Path(root).is_dir():
        print(f"{root}: is there already")
        return 0
    if not url and not photographs:
        raise DatasetError(f"{name}: has no archive that could be fetched; by hand, for {root}: {obtain or 'your own'}")
    published = Published(Path(root), url, obtain or "", recipe, settings.cache_dir)
    display = make_display(alone=True)
    display.start(name)
    try:
        with listening(lambda stage, done, total: display.update({"stage": stage, "step": done, "steps": total})):
            made = published.make(photographs, sha256)
    except FetchError as error:
        raise DatasetError(
            f"{error}\nCall this again to go on where it was. By hand: {obtain}. This folder is {root}; or put the "
            f"archive at {published.archives / Path(urlsplit(url or '').path).name} and call this again"
        ) from error
    finally:
        display.stop()
    print(made)
    print(f"train on it with: envgs-bench run dataset={name}")
    return 0
