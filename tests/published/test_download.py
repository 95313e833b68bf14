"""`envgs-bench download`, from a server on this machine that cuts connections, lies about hashes and packs traps."""

from __future__ import annotations

import hashlib
import io
import sys
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from envgs_bench.cli.main import main
from envgs_bench.datasets import DatasetError
from envgs_bench.published import fetching
from envgs_bench.published.fetching import FetchError, fetch
from envgs_bench.published.unpacking import unpack_scene

CONTENT = hashlib.sha256(b"").digest() * 10_000


class Server(ThreadingHTTPServer):
    """Serves `files` by ranges; the next answers end after so many bytes each as `cuts` says."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files: dict[str, bytes] = {}
        self.cuts: list[int] = []
        self.asked: list[tuple[str, str | None]] = []  # path and range

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.server_port}/{name}"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        name, wanted = self.path.strip("/"), self.headers["Range"]
        self.server.asked.append((name, wanted))
        if name not in self.server.files:
            self.send_error(404)
            return
        content = self.server.files[name]
        version = f'"{hashlib.sha256(content).hexdigest()[:8]}"'
        first = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted and self.headers["If-Range"] == version else 0
        self.send_response(206 if first else 200)
        if first:
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(content) - first))
        self.send_header("ETag", version)
        self.end_headers()
        end = first + self.server.cuts.pop(0) if self.server.cuts else None
        self.wfile.write(content[first:end])

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(fetching, "PAUSE_SECONDS", 0.0)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    running = Server()
    thread = threading.Thread(target=running.serve_forever, args=(0.01,))
    thread.start()
    yield running
    running.shutdown()
    thread.join()
    running.server_close()


def archive(files: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as content:
        for name, data in files.items():
            content.writestr(name, data)
    return stream.getvalue()


REF_REAL = archive(
    {
        "ref_real/sedan/images/1.jpg": b"one",
        "ref_real/sedan/sparse/0/cameras.bin": b"two",
        "ref_real/toycar/images/1.jpg": b"three",
        "__MACOSX/ref_real/sedan/images/._1.jpg": b"",
    }
)


def download(server: Server, tmp_path: Path, *options: str, name: str = "ref_real.zip") -> int:
    places = (f"data_root={tmp_path / 'data'}", f"cache_dir={tmp_path / 'cache'}")
    return main(["download", "ref_real/sedan", *places, f"dataset.download={server.url(name)}", *options])


def test_a_scene_is_unpacked_where_its_configuration_expects_it(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files["ref_real.zip"] = REF_REAL
    assert download(server, tmp_path) == 0
    assert "sedan: 2 files of" in capsys.readouterr().out
    root = tmp_path / "data" / "ref_real" / "sedan"
    assert {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()} == {
        "images/1.jpg": b"one",
        "sparse/0/cameras.bin": b"two",
    }
    assert [path.name for path in root.parent.iterdir()] == ["sedan"]
    assert download(server, tmp_path) == 0
    assert "sedan: is there already" in capsys.readouterr().out
    root.rename(root.with_name("moved"))
    assert download(server, tmp_path) == 0  # from the archive that was kept
    assert server.asked == [("ref_real.zip", None)]


def test_a_connection_that_is_cut_goes_on_where_it_was(server: Server, tmp_path: Path) -> None:
    server.files["a.zip"] = CONTENT
    server.cuts = [1000, 50_000]
    path = fetch(server.url("a.zip"), tmp_path, hashlib.sha256(CONTENT).hexdigest())
    assert path.read_bytes() == CONTENT
    assert server.asked == [("a.zip", None), ("a.zip", "bytes=1000-"), ("a.zip", "bytes=51000-")]
    assert [each.name for each in tmp_path.iterdir()] == ["a.zip"]


def test_a_later_call_goes_on_and_begins_anew_where_the_file_has_changed(server: Server, tmp_path: Path) -> None:
    server.files["a.zip"] = CONTENT
    for changed in (CONTENT, b"x" + CONTENT[1:]):
        server.cuts = [70_000, 0]
        with pytest.raises(FetchError, match=r"a\.zip: "):
            fetch(server.url("a.zip"), tmp_path)
        assert (tmp_path / "a.zip.part").stat().st_size == 70_000
        server.files["a.zip"] = changed
        assert fetch(server.url("a.zip"), tmp_path).read_bytes() == changed
        assert server.asked[-1] == ("a.zip", "bytes=70000-")
        (tmp_path / "a.zip").unlink()
        server.files["a.zip"] = CONTENT


def test_another_hash_is_refused_and_nothing_kept(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files["ref_real.zip"] = REF_REAL
    assert download(server, tmp_path, "--sha256", "0" * 64) == 1
    message = capsys.readouterr().err
    assert hashlib.sha256(REF_REAL).hexdigest() in message
    assert "By hand: Ref-Real is http://127.0.0.1" in message
    assert not (tmp_path / "data").exists()
    assert not list((tmp_path / "cache" / "downloads").iterdir())
    assert download(server, tmp_path, "--sha256", hashlib.sha256(REF_REAL).hexdigest()) == 0


def test_a_host_that_fails_says_what_to_do_by_hand(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert download(server, tmp_path) == 1
    message = capsys.readouterr().err
    assert "ref_real.zip: 404" in message
    assert (
        f"unpack it so that this folder holds images/ and sparse/0/. This folder is {tmp_path}/data/ref_real" in message
    )
    assert f"put the archive at {tmp_path}/cache/downloads/ref_real.zip and call this again" in message
    nowhere = "dataset.download=http://127.0.0.1:9/ref_real.zip"  # discard's port, where nobody listens
    places = (f"data_root={tmp_path / 'data'}", f"cache_dir={tmp_path / 'cache'}")
    assert main(["download", "ref_real/sedan", *places, nowhere]) == 1
    message = capsys.readouterr().err
    assert "Connection refused" in message
    assert "By hand: Ref-Real is" in message
    (tmp_path / "cache" / "downloads").mkdir(parents=True, exist_ok=True)
    (tmp_path / "cache" / "downloads" / "ref_real.zip").write_bytes(REF_REAL)  # as it says
    assert main(["download", "ref_real/sedan", *places, nowhere]) == 0


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"sedan/1.jpg": b"", "sedan/../../evil": b""}, "names files outside of itself (sedan/../../evil)"),
        ({"sedan/1.jpg": b"", "/etc/evil": b""}, "names files outside of itself (/etc/evil)"),
        ({"sedan/1.jpg": b"", "..\\evil": b""}, "names files outside of itself (../evil)"),
        ({"sedan/1.jpg": b"", "C:/evil": b""}, "names files outside of itself (C:/evil)"),
        ({"toycar/1.jpg": b""}, "holds no folder sedan, only toycar"),
    ],
)
def test_archives_that_lead_out_or_lack_the_scene_unpack_nothing(
    tmp_path: Path, files: dict[str, bytes], message: str
) -> None:
    (tmp_path / "a.zip").write_bytes(archive(files))
    with pytest.raises(DatasetError) as caught:
        unpack_scene(tmp_path / "a.zip", tmp_path / "data" / "sedan")
    assert message in str(caught.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "a.zip"]


def test_a_damaged_archive_unpacks_nothing(tmp_path: Path) -> None:
    whole = archive({"sedan/1.jpg": CONTENT, "sedan/2.jpg": CONTENT})
    for damaged in (whole[:-30], whole[:200] + bytes(8) + whole[208:], b"<html>moved</html>"):
        (tmp_path / "a.zip").write_bytes(damaged)
        with pytest.raises(DatasetError, match=r"a\.zip: cannot be unpacked .*delete it and download it again"):
            unpack_scene(tmp_path / "a.zip", tmp_path / "data" / "sedan")
        assert not list((tmp_path / "data").iterdir()) if (tmp_path / "data").exists() else True


def test_a_link_in_an_archive_leads_nowhere(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("sedan/images")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as content:
        content.writestr(link, "/tmp")
    unpack_scene(tmp_path / "a.zip", tmp_path / "sedan")
    assert not (tmp_path / "sedan" / "images").is_symlink()
    assert (tmp_path / "sedan" / "images").read_text() == "/tmp"


def test_what_is_not_published_or_not_installed_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    places = (f"data_root={tmp_path}", f"cache_dir={tmp_path / 'cache'}")
    assert main(["download", "toy/glass", *places]) == 1
    assert "is made here, and not downloaded: envgs-bench run dataset=toy/glass" in capsys.readouterr().err
    assert main(["download", "envgs/audi", *places]) == 1
    assert "by hand, for" in capsys.readouterr().err
    assert main(["download", "ref_real/sedann", *places]) == 1
    assert "Did you mean 'sedan'?" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pooch", None)
    assert main(["download", "ref_real/sedan", *places]) == 1
    assert "pip install 'envgs-bench[download]'" in capsys.readouterr().err
