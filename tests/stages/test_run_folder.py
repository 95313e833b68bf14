"""A run's files of different views, regions and layers are different files, whatever they are called."""

import os
from itertools import combinations, product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.records import write_atomically
from envgs_bench.run_folder import (
    CONFIG_NAME,
    RECORD_NAME,
    SNAPSHOT_NAME,
    clear,
    exact_normal_path,
    layer_path,
    layers_of,
    mask_path,
    render_path,
    target_path,
)
from envgs_bench.stages.snapshots import write_state

NAMES = st.lists(st.text("ab-", min_size=1, max_size=5), min_size=2, max_size=4, unique=True)


@given(views=NAMES, parts=NAMES)
def test_no_two_names_share_a_file(views, parts):
    run = Path("run")
    files = [path(run, view) for path in (render_path, target_path, exact_normal_path) for view in views]
    files += [path(run, view, part) for path in (mask_path, layer_path) for view, part in product(views, parts)]
    assert all(one != other for one, other in combinations(files, 2))


def test_layers_are_the_views_own(tmp_path):
    for view, layer in (("a", "beta"), ("a-b", "beta"), ("a-b", "c"), ("a", "b-c")):
        layer_path(tmp_path, view, layer).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (1, 1)).save(layer_path(tmp_path, view, layer))
    assert sorted(layers_of(tmp_path, "a")) == ["b-c", "beta"]
    assert sorted(layers_of(tmp_path, "a-b")) == ["beta", "c"]


def test_what_a_kill_left_half_written_is_cleared(tmp_path, monkeypatch):
    """A process that is killed cannot remove its file: neither here, where removing does nothing."""
    write_state(tmp_path / SNAPSHOT_NAME, {"step": 1})
    (tmp_path / ".notes.md").touch()  # somebody's own

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", killed)
        patch.setattr(os, "unlink", lambda *_: None)
        patch.setattr(Path, "unlink", lambda *_, **__: None)
        for write in (
            lambda: write_atomically(tmp_path / RECORD_NAME, "{}"),
            lambda: write_atomically(tmp_path / CONFIG_NAME, "a: 1"),
            lambda: write_state(tmp_path / SNAPSHOT_NAME, {"step": 2}),
        ):
            with pytest.raises(KeyboardInterrupt):
                write()
    assert len(list(tmp_path.iterdir())) == 5
    clear(tmp_path, keep=(SNAPSHOT_NAME,))
    assert sorted(path.name for path in tmp_path.iterdir()) == [".notes.md", SNAPSHOT_NAME]
