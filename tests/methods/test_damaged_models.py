"""Models that anybody may have damaged or made up: a ValueError that names the file, and nothing of theirs is run."""

from __future__ import annotations

import os
import pickle
import struct
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.checkpoint import FILE_NAME, read_checkpoint
from envgs_bench.methods.storage.ply import read_ply
from envgs_bench.testing import tiny_scene

NAMES = [
    "x",
    "y",
    "z",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
]


def write_set(path: Path, count: object = 2, kind: str = "float", names: list[str] = NAMES) -> Path:
    properties = "".join(f"property {kind} {name}\n" for name in names)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n"
    path.write_bytes(head.encode() + struct.pack(f"<{2 * len(NAMES)}f", *[0.5] * 2 * len(NAMES)))
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 10**9}, "promises 1000000000 rows of vertex, the file has"),
        ({"count": 2**70}, "rows of vertex, the file has"),
        ({"count": -1}, "promises -1 rows"),
        ({"count": "9" * 5000}, "is no readable PLY"),
        ({"kind": "list uchar float", "count": 1, "names": ["x", "y", "z"]}, "has no property x, y, z"),
        ({"names": []}, "does not say what a row of vertex holds"),
        ({"names": [*NAMES[:12], "x"]}, "is no readable PLY"),
    ],
)
def test_sets_that_are_none(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    assert len(read_ply(write_set(tmp_path / "whole.ply"))["means"]) == 2
    path = write_set(tmp_path / "a.ply", **changes)
    with pytest.raises(ValueError, match=r"a\.ply") as caught:
        read_ply(path)
    assert message in str(caught.value)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.ply")
    with pytest.raises(ValueError, match=r"a\.ply: cannot be read \(it is a named pipe"):
        read_ply(tmp_path / "a.ply")
    os.mkfifo(tmp_path / FILE_NAME)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        read_checkpoint(tmp_path, "EnvGS", torch.device("cpu"))


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("checkpoint")
    method = create_method("envgs", {}, "cpu", 0)
    method.initialize(tiny_scene(), 10)
    method.save(folder)
    return (folder / FILE_NAME).read_bytes()


def load(folder: Path, content: bytes) -> None:
    (folder / FILE_NAME).write_bytes(content)
    create_method("envgs", {}, "cpu", 0).load(folder)


@pytest.mark.parametrize("share", [0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_checkpoint_is_named(tmp_path: Path, checkpoint: bytes, share: float) -> None:
    with pytest.raises(ValueError, match=r"model\.pt is not a readable checkpoint"):
        load(tmp_path, checkpoint[: int(share * len(checkpoint))])


@pytest.mark.parametrize("state", [{"method": "EnvGS"}, {"method": "EnvGS", "sets": 5}, {"method": "2DGS"}, [], 5])
def test_a_checkpoint_of_something_else_is_named(tmp_path: Path, state: object) -> None:
    torch.save(state, tmp_path / FILE_NAME)
    with pytest.raises(ValueError, match=str(tmp_path)):
        create_method("envgs", {}, "cpu", 0).load(tmp_path)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "made"),)

    with pytest.raises(ValueError, match=r"model\.pt is not a readable checkpoint"):
        load(tmp_path, pickle.dumps(Hostile()))
    torch.save({"method": "EnvGS", "sets": Hostile()}, tmp_path / FILE_NAME)
    with pytest.raises(ValueError, match=r"model\.pt is not a readable checkpoint"):
        create_method("envgs", {}, "cpu", 0).load(tmp_path)
    assert not (tmp_path / "made").exists()


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@settings(max_examples=100, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_checkpoints_are_read_or_named(data: st.DataObject, checkpoint: bytes) -> None:
    content = bytearray(checkpoint)
    for _ in range(data.draw(st.integers(1, 10))):
        content[data.draw(st.integers(0, 2000))] = data.draw(st.integers(0, 255))
    with TemporaryDirectory() as folder:
        try:
            load(Path(folder), bytes(content))
        except ValueError as error:
            named = folder in str(error)
            assert named
