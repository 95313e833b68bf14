"""Composes a published data set as a run would, fetches its archive and unpacks the scene out of that."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.progress import listening
from envgs_bench.published.fetching import FetchError, fetch
from envgs_bench.published.unpacking import unpack_scene
from envgs_bench.runs.display import make_display

from .composition import composed

ARCHIVES = "downloads"  # the folder of the cache that keeps archives, which hold several scenes


def download(name: str, overrides: list[str], sha256: str | None) -> int:
    """Make the folder that `dataset=<name>` reads, unless it is there; returns the exit status, 0.

    Raises:
        DatasetError: it is not published as one archive, or that cannot be had or unpacked; the message says what to
            do by hand.
        OSError: the folder or the cache cannot be written.
    """
    settings = composed([f"dataset={name}", *overrides])
    root, url, obtain = (settings.dataset.get(key) for key in ("root", "download", "obtain"))
    if not root:
        raise DatasetError(f"{name}: is made here, and not downloaded: envgs-bench run dataset={name}")
    if Path(root).is_dir():
        print(f"{root}: is there already")
        return 0
    if not url:
        raise DatasetError(f"{name}: has no archive that could be fetched; by hand, for {root}: {obtain or 'your own'}")
    archives = settings.cache_dir / ARCHIVES
    display = make_display(alone=True)
    display.start(name)
    try:
        with listening(lambda stage, done, total: display.update({"stage": stage, "step": done, "steps": total})):
            archive = fetch(url, archives, sha256)
            files = unpack_scene(archive, Path(root))
    except FetchError as error:
        raise DatasetError(
            f"{error}\nCall this again to go on where it was. By hand: {obtain}. This folder is {root}; or put the "
            f"archive at {archives / Path(urlsplit(url).path).name} and call this again"
        ) from error
    finally:
        display.stop()
    print(f"{root}: {files} files of {archive}, which may be deleted once no other scene of it is wanted")
    print(f"train on it with: envgs-bench run dataset={name}")
    return 0
