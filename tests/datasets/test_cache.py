"""The cache of made scenes: keyed by what files hold, written as scenes are made, mapped when read."""

from __future__ import annotations

import json
import os
import re
import shutil
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
import pytest
import torch
from captures import NAMES_OF_TEN, gradient, write_capture
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.progress import listening, streamed
from envgs_bench.datasets.sources import capture
from envgs_bench.datasets.store import contents
from envgs_bench.datasets.store.cache import cached_scene
from envgs_bench.datasets.store.contents import digest_of
from envgs_bench.datasets.store.scene_file import GrowingFile, on_disk, read_scene
from envgs_bench.testing import tiny_scene


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **settings}, root.parent / "cache")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bench", NAMES_OF_TEN)


def scenes(root: Path) -> list[Path]:
    return list((root.parent / "cache/scenes").iterdir())


def test_moved_copied_and_touched_files_are_the_same_scene(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(root)
    monkeypatch.setattr(capture, "make_scene", lambda *_: pytest.fail("made again"))
    for path in root.rglob("*"):
        os.utime(path, (1, 1))
    load(root)
    moved = root.parent / "elsewhere"
    shutil.copytree(root, moved)
    load(moved, name="bench")
    assert len(scenes(root)) == 1


def test_a_change_that_keeps_name_size_and_time_is_seen(root: Path) -> None:
    """As a copy that restores times leaves it: uncompressed pictures of one size and one time of change."""
    for name in NAMES_OF_TEN:
        Image.fromarray(gradient()).save(root / "images" / name, format="BMP")
    before = load(root)
    path = root / "images/001.png"
    status = path.stat()
    Image.fromarray(255 - gradient()).save(path, format="BMP")
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (status.st_size, status.st_mtime_ns)
    assert not torch.equal(load(root).train[0].image, before.train[0].image)


def test_a_renamed_file_is_another_scene(root: Path) -> None:
    files = sorted((root / "images").iterdir())
    before = digest_of(files, root, root.parent / "cache")
    files[0].rename(root / "images/renamed.png")
    assert digest_of(sorted((root / "images").iterdir()), root, root.parent / "cache") != before


def test_files_that_did_not_change_are_not_read_again(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []
    hash_of = contents._hash
    monkeypatch.setattr(contents, "_hash", lambda path: (read.append(path), hash_of(path))[1])
    files = sorted((root / "images").iterdir())
    first = digest_of(files, root, root.parent / "cache")
    assert sorted(read) == files
    read.clear()
    assert digest_of(files, root, root.parent / "cache") == first
    assert read == []
    Image.fromarray(255 - gradient()).save(files[3])
    assert digest_of(files, root, root.parent / "cache") != first
    assert read == [files[3]]


def test_a_damaged_file_of_digests_is_made_again(root: Path) -> None:
    cache = root.parent / "cache"
    files = sorted((root / "images").iterdir())
    first = digest_of(files, root, cache)
    (memory,) = (cache / "digests").iterdir()
    names = [path.relative_to(root).as_posix() for path in files]
    for damaged in ("{", "[]", "[" * 50_000, *(json.dumps(dict.fromkeys(names, odd)) for odd in (1, [], [[1]], None))):
        memory.write_text(damaged)
        assert digest_of(files, root, cache) == first


def test_scenes_are_mapped_and_stay_as_they_were_when_written_into(root: Path) -> None:
    load(root)
    scene = load(root)
    (path,) = scenes(root)
    maps = Path("/proc/self/maps")
    if maps.is_file():
        assert str(path) in maps.read_text()
    assert scene.train[0].image.dtype == torch.uint8
    scene.train[0].image.zero_()
    assert load(root).train[0].image.any()


def test_views_are_on_disk_as_soon_as_they_are_made(tmp_path: Path) -> None:
    scene = tiny_scene()
    kept: list[torch.Tensor] = []

    def make() -> Scene:
        train = on_disk(scene.train)
        images = [view.image for view in train]
        kept.extend(images)
        (part,) = (tmp_path / "scenes").glob("*.part")
        assert part.stat().st_size >= sum(image.numel() for image in images)
        return replace(scene, train=train)

    again = [cached_scene(tmp_path, "a", {}, make) for _ in range(2)]
    for ours, theirs in zip(scene.train, again[1].train, strict=True):
        assert torch.equal(ours.image, theirs.image)
    cached_scene(tmp_path, "b", {}, lambda: scene)
    kept_early, kept_late = (next((tmp_path / "scenes").glob(f"{name}-*")).stat().st_size for name in "ab")
    assert kept_early == pytest.approx(kept_late, abs=1000)  # nothing is there twice
    assert all(torch.equal(a, view.image) for a, view in zip(kept, scene.train, strict=True))


def test_of_two_that_ask_at_once_one_makes_the_scene_and_the_other_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("envgs_bench.file_lock.PATIENCE", 0.01)
    scene, begun, told, makings = tiny_scene(), threading.Event(), threading.Event(), []

    def make() -> Scene:
        makings.append(1)
        begun.set()
        assert told.wait(20)  # until the other one has said that it waits
        return scene

    def other() -> Scene:
        def listen(stage: str, done: int, total: int) -> None:
            if "waiting for another process" in stage:
                told.set()

        assert begun.wait(20)
        with listening(listen):
            return cached_scene(tmp_path, "a", {}, make)

    with ThreadPoolExecutor(2) as pool:
        results = [pool.submit(cached_scene, tmp_path, "a", {}, make), pool.submit(other)]
        ours, theirs = (result.result() for result in results)
    assert makings == [1]
    assert torch.equal(ours.train[0].image, theirs.train[0].image)
    assert [path.suffix for path in (tmp_path / "scenes").iterdir()] == [".scene"]  # and no lock is left


def test_where_no_file_can_be_locked_nobody_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envgs_bench.file_lock.fcntl", None)
    scene = tiny_scene()
    assert torch.equal(cached_scene(tmp_path, "a", {}, lambda: scene).points, scene.points)


def test_no_more_is_read_ahead_than_two_views_a_core() -> None:
    begun: list[int] = []

    def read(index: int) -> int:
        begun.append(index)
        return index

    results = streamed("reading", read, range(1000))
    assert not begun
    assert [next(results) for _ in range(10)] == list(range(10))
    time.sleep(0.1)  # for the threads to run as far ahead as they may
    assert len(begun) <= 9 + 2 * (os.cpu_count() or 1)
    assert list(results) == list(range(10, 1000))


def test_a_disk_that_fills_up_costs_the_cache_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Linux has one: what is buffered fails when it is written, and again when the file is closed."""
    scene, opened = tiny_scene(), GrowingFile._open

    def on_a_full_disk(file: GrowingFile) -> BinaryIO:
        opened(file).close()
        file._stream = Path("/dev/full").open("wb")  # noqa: SIM115
        return file._stream

    monkeypatch.setattr(GrowingFile, "_open", on_a_full_disk)
    with collecting() as notes:
        made = cached_scene(tmp_path, "a", {}, lambda: replace(scene, train=on_disk(scene.train)))
    (text,) = notes
    assert re.search("could not be cached .*, and is made again for each run: .*No space left", text)
    assert torch.equal(made.points, scene.points)
    assert not list((tmp_path / "scenes").glob("*"))


def test_every_kind_of_tensor_survives(tmp_path: Path) -> None:
    scene = tiny_scene()
    odd = torch.from_numpy(np.arange(30, dtype=np.float32).reshape(5, 6)[:, ::2].copy())
    bare = replace(
        scene,
        train=[replace(scene.train[0], depth=odd, normal=None, masks={"none": torch.zeros(5, 3, dtype=torch.bool)})],
        points=torch.empty(0, 3),
        point_colors=torch.empty(0, 3),
    )
    for _ in range(2):
        read = cached_scene(tmp_path, "a", {}, lambda: bare)
        assert torch.equal(read.train[0].depth, odd)
        assert read.train[0].normal is None
        assert torch.equal(read.train[0].masks["none"], bare.train[0].masks["none"])
        assert read.points.shape == (0, 3)


def zero_half(content: bytearray) -> None:
    content[len(content) // 4 : len(content) * 3 // 4] = bytes(len(content) * 3 // 4 - len(content) // 4)


def flip_first(content: bytearray) -> None:
    content[0] ^= 1


def flip_last_pixel(content: bytearray) -> None:
    """The JSON behind the tensors begins with this."""
    content[content.index(b'{"scene"') - 1] ^= 128


def flip_index(content: bytearray) -> None:
    """A digit of a camera: the JSON still is one."""
    content[content.index(b'"camera": [["torch.float32", [[1') + 30] ^= 2


def flip_footer(content: bytearray) -> None:
    content[-20] ^= 1


def lose_a_page(content: bytearray) -> None:
    del content[4096:8192]


@pytest.mark.parametrize(
    "damage", [zero_half, flip_first, flip_last_pixel, flip_index, flip_footer, lose_a_page], ids=lambda f: f.__name__
)
def test_a_scene_that_the_disk_changed_is_noticed_and_made_again(root: Path, damage: Callable) -> None:
    before = load(root)
    (path,) = scenes(root)
    content = bytearray(path.read_bytes())
    damage(content)
    path.unlink()  # which `before` is mapped from
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=r"bench-.*\.scene cannot be read .*; it is made again"):
        again = load(root)
    for ours, theirs in zip([*before.train, *before.test], [*again.train, *again.test], strict=True):
        assert torch.equal(ours.image, theirs.image)
        assert torch.equal(ours.camera.intrinsics, theirs.camera.intrinsics)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(root)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_any_bit_of_a_scene_that_counts_is_checked(data: st.DataObject) -> None:
    """Between the tensors lie bytes that nothing reads; a flip anywhere else is noticed."""
    with TemporaryDirectory() as name:
        scene = tiny_scene()
        cached_scene(Path(name), "a", {}, lambda: scene)
        (path,) = (Path(name) / "scenes").iterdir()
        content = bytearray(path.read_bytes())
        bit = data.draw(st.integers(0, 8 * len(content) - 1))
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        try:
            read, _ = read_scene(path)
        except (OSError, KeyError, ValueError, TypeError):
            return
        for ours, theirs in zip([*scene.train, *scene.test], [*read.train, *read.test], strict=True):
            assert torch.equal(ours.image, theirs.image)
            assert torch.equal(ours.camera.world_to_camera, theirs.camera.world_to_camera)
        assert torch.equal(scene.points, read.points)
