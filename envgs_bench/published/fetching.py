"""Fetching: a file from its address, by pooch; one that was cut off goes on where it was."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from envgs_bench.datasets.errors import DatasetError
from envgs_bench.datasets.progress import report

ATTEMPTS = 5  # to go on after a connection was cut, before it is left to the user
PAUSE_SECONDS = 2.0  # before the next, twice as long each time
TIMEOUT_SECONDS = (20, 60)  # to be answered at all, and between two pieces
PIECE_BYTES = 1 << 20


class FetchError(DatasetError):
    """A file that cannot be had; the message says why."""


def fetch(url: str, folder: Path, sha256: str | None = None) -> Path:
    """The file at `url`, from `folder` where it lies there already; reports how many bytes are there, of how many.

    What a connection that was cut has brought stays, beside it, as <name>.part, and the next call goes on from there.

    Args:
        sha256: hexadecimal; not compared where None.

    Raises:
        FetchError: pooch is not installed, the host cannot be reached or refuses, or the hash is another one.
        OSError: the file cannot be written.
    """
    try:
        import pooch
    except ImportError as error:
        raise FetchError("downloads need pooch: pip install 'envgs-bench[download]'") from error
    pooch.get_logger().setLevel("ERROR")  # it would tell users to write down hashes in code
    name = Path(urlsplit(url).path).name
    try:
        return Path(pooch.retrieve(url, sha256, fname=name, path=folder, downloader=_download))
    except FetchError:
        raise
    except ValueError as error:
        raise FetchError(f"{url}: {error}") from error


def _download(url: str, output: str, _: Any) -> None:
    """pooch's downloader: `output` is a file of its own, which takes the name's place once the hash is right."""
    import requests

    part = Path(output).parent / f"{Path(urlsplit(url).path).name}.part"
    pause = PAUSE_SECONDS
    for attempt in range(1, ATTEMPTS + 1):
        before = part.stat().st_size if part.is_file() else 0
        try:
            _go_on(url, part)
            break
        except requests.HTTPError as error:
            raise FetchError(f"{url}: {error}") from error
        except requests.RequestException as error:
            if attempt == ATTEMPTS or (part.stat().st_size if part.is_file() else 0) == before:
                raise FetchError(f"{url}: {error}") from error
        time.sleep(pause)
        pause *= 2
    _origin(part).unlink(missing_ok=True)
    os.replace(part, output)


def _go_on(url: str, part: Path) -> None:
    """Append what `part` lacks, or begin anew where the server's file is another one by now."""
    import requests

    done, length, version = _so_far(url, part)
    if length and done == length:
        return
    headers = {"Accept-Encoding": "identity"}
    if done and version:
        headers |= {"Range": f"bytes={done}-", "If-Range": version}
    with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_SECONDS) as response:
        response.raise_for_status()
        if response.status_code != requests.codes.partial_content:
            done = 0
        total = done + int(response.headers.get("Content-Length", 0))
        version = response.headers.get("ETag") or response.headers.get("Last-Modified")
        origin = {"url": url, "version": version, "length": total}
        _origin(part).write_text(json.dumps(origin), encoding="utf-8")
        with part.open("ab" if done else "wb") as stream:
            for piece in _pieces(response):
                stream.write(piece)
                done += len(piece)
                report("downloading MB", done // 1_000_000, max(total, done) // 1_000_000)
    if done < total:
        raise requests.ConnectionError(f"the connection was cut after {done:,} of {total:,} bytes")


def _pieces(response: Any) -> Iterator[bytes]:
    """What comes, as it comes, until nothing does: requests' own pieces would lose the last before a cut."""
    import urllib3

    try:
        while piece := response.raw.read1(PIECE_BYTES):
            yield piece
    except urllib3.exceptions.HTTPError:
        return


def _so_far(url: str, part: Path) -> tuple[int, int, str | None]:
    """The bytes in `part`, how many the server's file has, and which version of it that is; zeros where unknown."""
    try:
        origin = json.loads(_origin(part).read_text(encoding="utf-8"))
        known = part.stat().st_size, int(origin["length"]), origin["version"]
        return known if origin["url"] == url and origin["version"] else (0, 0, None)
    except (OSError, ValueError, KeyError, TypeError):
        return 0, 0, None


def _origin(part: Path) -> Path:
    """Where it is written down what `part` is a part of."""
    return part.with_name(f"{part.name}.json")
