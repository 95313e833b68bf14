"""Names in data find their own files: however Unicode spells them, never another's, and never what is hidden."""

from __future__ import annotations

import logging
import tempfile
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from captures import HEIGHT, NAMES_OF_TEN, WIDTH, gradient, write_capture
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.image_files import ImageFiles
from envgs_bench.datasets.formats.names import composed, visible_files
from envgs_bench.stages.render_files import rendered_files

HIDDEN = ("._000.png", ".DS_Store", ".thumbnails/000.png", "__MACOSX/000.png")
STEMS = st.text("aAé\u0301ñ .-_1βё", min_size=1, max_size=4).filter(lambda text: text.strip(" .") == text)


def load(root: Path, **keys: object) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **keys}, root.parent / "cache")


def names_of(scene: Scene) -> list[str]:
    return sorted(view.name for view in (*scene.train, *scene.test))


@settings(max_examples=60, deadline=None)
@given(st.lists(STEMS, min_size=1, max_size=5), st.sampled_from(["NFC", "NFD"]), st.sampled_from(["NFC", "NFD"]))
def test_names_find_their_own_files(stems: list[str], told: str, stored: str) -> None:
    """Each file holds its name: what a name finds is that, or nothing, or an error says why."""
    names = {composed(stem) + ".png" for stem in stems}
    missing = composed(stems[0]) + ".png"
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            (Path(folder) / unicodedata.normalize(stored, name)).write_text(name)
        files = ImageFiles(Path(folder), names, Path("model"))
        for name in names:
            found = files.find(unicodedata.normalize(told, name))
            assert found is not None
            assert found.read_text() == name
        (Path(folder) / unicodedata.normalize(stored, missing)).unlink()
        assert ImageFiles(Path(folder), names, Path("model")).find(unicodedata.normalize(told, missing)) is None


def test_a_converted_file_stands_in_where_it_is_the_only_one(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    (tmp_path / "a.jpg").touch()
    files = ImageFiles(tmp_path, ["a.png", "b.png"], Path("model"))
    assert files.find("a.png") == tmp_path / "a.jpg"
    files.note_converted()
    assert "1 images were taken from files with another extension than it names: a.png" in caplog.text
    assert ImageFiles(tmp_path, ["a.png", "a.jpg"], Path("model")).find("a.png") is None  # another name's own
    (tmp_path / "a.webp").touch()
    with pytest.raises(DatasetError, match=r"names the image a\.png, which .* several .*: a\.jpg, a\.webp"):
        ImageFiles(tmp_path, ["a.png"], Path("model")).find("a.png")


def test_hidden_files_are_left_alone_everywhere(tmp_path: Path) -> None:
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN)
    for folder in ("masks", "normals"):
        (root / folder).mkdir()
        for name in NAMES_OF_TEN:
            pixels = np.full((HEIGHT, WIDTH, 3), [128, 128, 0], np.uint8)
            pixels[:9] *= folder == "normals"
            Image.fromarray(pixels).save(root / folder / name)
    for folder in ("images", "masks", "normals"):
        for name in HIDDEN:
            path = root / folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(b"\0\5\26\7")
    assert names_of(load(root)) == [Path(name).stem for name in NAMES_OF_TEN]
    assert [path.name for path in visible_files(root / "images")] == NAMES_OF_TEN
    assert [path.name for path in rendered_files(root / "images")] == NAMES_OF_TEN


def test_views_are_split_in_the_order_of_paths(tmp_path: Path) -> None:
    """As programs split that sort the names of a model: every eighth of cam1/…, cam10/…, cam11/…, cam12/…, cam2/…"""
    names = [f"cam{camera}/{index:03d}.png" for camera in range(1, 13) for index in range(3)]
    scene = load(write_capture(tmp_path / "bench", names))
    assert [view.name for view in scene.test] == ["cam1_000", "cam11_002", "cam3_001", "cam6_000", "cam8_002"]


def test_masks_are_found_however_their_names_are_spelled(tmp_path: Path) -> None:
    names = [f"{unicodedata.normalize('NFC', 'é')}_{index}.0.png" for index in range(9)]
    root = write_capture(tmp_path / "bench", names)
    (root / "masks").mkdir()
    for index, name in enumerate(names):
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[index] = 255
        Image.fromarray(mask).save(root / "masks" / unicodedata.normalize("NFD", name))
        (root / "images" / name).rename(root / "images" / unicodedata.normalize("NFD", name))
    for view in (scene := load(root)).train:
        assert view.masks["foreground"].any(dim=1).nonzero().item() == int(view.name.removeprefix("é_")[0])
        np.testing.assert_array_equal(view.image, gradient())
    assert len(scene.train) == 7
