"""Compiled kernels on disk: a damaged one is made again. Needs no GPU."""

from __future__ import annotations

from pathlib import Path

import pytest

from envgs_bench.core.cuda import compiler


def test_kept_machine_code_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "kernels" / "a.cubin"
    assert compiler.remembered(path) is None
    compiler.remember(path, b"machine code")
    assert compiler.remembered(path) == b"machine code"
    for damaged in (path.read_bytes()[:-1], b"", path.read_bytes().replace(b"code", b"cade"), b"machine code"):
        path.write_bytes(damaged)
        assert compiler.remembered(path) is None
    compiler.remember(path, b"machine code")
    assert compiler.remembered(path) == b"machine code"


def test_what_cannot_be_kept_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(compiler.os, "replace", full)
    compiler.remember(tmp_path / "a.cubin", b"machine code")
    assert not list(tmp_path.iterdir())


def test_they_lie_where_the_run_was_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "_folder", None)
    monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path))
    assert compiler.cache_dir() == tmp_path / "kernels"
    compiler.keep_kernels_in(tmp_path / "mine")
    assert compiler.cache_dir() == tmp_path / "mine"
