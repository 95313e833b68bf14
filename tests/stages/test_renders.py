"""method=renders: pictures of another program take part, and every misfit is listed at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from fakes.runs import only_folder, records, run_here, run_job_here, set_environment
from PIL import Image

from envgs_bench.core import View
from envgs_bench.records import read_record
from envgs_bench.reports import build_report
from envgs_bench.stages.renders import RendersError, match_renders, read_render
from envgs_bench.testing import HEIGHT, WIDTH, tiny_scene

BLACK = torch.zeros(3)


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def views() -> list[View]:
    return tiny_scene().train[:3]  # view1, view2, view3


def write(path: Path, width: int = WIDTH, height: int = HEIGHT, mode: str = "RGB") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, (width, height)).save(path)


def test_the_renders_of_a_run_score_as_the_run(tmp_path: Path) -> None:
    """Given back as pictures, what a method drew gets the same numbers under a protocol that rounds to 8 bits."""
    assert run_job_here(tmp_path / "runs", "protocol=strict") == 0
    folder = only_folder(tmp_path / "runs")
    options = ("method=renders", f"path={folder / 'renders'}", "method.name=elsewhere", "protocol=strict")
    assert run_job_here(tmp_path / "others", *options) == 0
    (theirs,), ours = records(tmp_path / "others"), read_record(folder)
    assert theirs.metrics is not None
    assert ours.metrics is not None
    for mine, other in zip(ours.metrics.per_view, theirs.metrics.per_view, strict=True):
        assert {**other.scores, "normal_degrees": mine.scores["normal_degrees"]} == mine.scores
    assert theirs.masked["reflective"].scores["psnr"] == ours.masked["reflective"].scores["psnr"]
    assert (theirs.method, theirs.kind, theirs.steps) == ("elsewhere", "renders", 0)
    assert theirs.timing is None
    assert theirs.cost is None
    copied = only_folder(tmp_path / "others")
    names = {str(path.relative_to(copied)) for path in copied.rglob("*.png")}
    assert {"renders/view0.png", "targets/view0.png", "masks/reflective/view0.png", "layers/error/view0.png"} <= names
    (section,) = build_report(tmp_path, tmp_path / "report").sections  # what took no times stands beside what did
    tidy = section.tidy[section.tidy["metric"] == "frame_ms"]
    assert list(tidy["method"]) == ["fake"]
    lines = (tmp_path / "report" / "table.md").read_text().splitlines()
    assert "| — |" in next(line for line in lines if line.startswith("| elsewhere |"))


def test_pictures_drawn_again_are_another_run(tmp_path: Path) -> None:
    for view in ("view0", "view1"):
        write(tmp_path / "renders" / f"{view}.png")
    (tmp_path / "renders").rename(tmp_path / "tiny")
    options = ("method=renders", f"path={tmp_path}/${{dataset.name}}")  # one call for many scenes
    assert run_job_here(tmp_path / "runs", *options) == 0
    assert run_job_here(tmp_path / "runs", *options) == 0
    assert len(records(tmp_path / "runs")) == 1
    Image.new("RGB", (WIDTH, HEIGHT), (9, 9, 9)).save(tmp_path / "tiny" / "view0.png")
    assert run_job_here(tmp_path / "runs", *options) == 0
    assert len(records(tmp_path / "runs")) == 2


def test_misfits_are_all_listed_in_one_error(tmp_path: Path) -> None:
    write(tmp_path / "view1.png", width=WIDTH + 1)
    write(tmp_path / "surplus.jpg")
    write(tmp_path / "more" / "surplus.png")
    (tmp_path / "notes.txt").write_text("no picture")
    (tmp_path / "view2.png").write_text("no picture either")
    with pytest.raises(RendersError) as caught:
        match_renders(tmp_path, "name", views())
    message = str(caught.value)
    for part in (
        f"{tmp_path}: does not fit the 3 test views",
        "1 views without a file: view3",
        "2 files without a view: more/surplus.png, surplus.jpg",
        f"2 files that are not their view's: view1.png: is {WIDTH + 1}×{HEIGHT} pixels, its view {WIDTH}×{HEIGHT}",
        "view2.png: cannot be read",
        "match=order takes numbered files",
    ):
        assert part in message


def test_a_run_with_misfits_fails_with_the_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "renders" / "view0.png")
    assert run_here(tmp_path / "runs", "method=renders", f"path={tmp_path / 'renders'}") == 1
    (record,) = records(tmp_path / "runs")
    assert record.status == "failed"
    assert record.error is not None
    assert record.error.type == "RendersError"
    assert "1 views without a file: view1" in record.error.message
    assert "1 views without a file: view1" in capsys.readouterr().out


def test_without_a_path_nothing_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(tmp_path, "method=renders") == 2
    assert "path is missing: give it as path=VALUE" in capsys.readouterr().err
    assert records(tmp_path) == []


def test_names_match_by_stem_with_folders_as_the_data_set_writes_them(tmp_path: Path) -> None:
    named = [View(name, view.camera, view.image) for name, view in zip(("a_0", "a_1", "b"), views(), strict=True)]
    for file in ("a/0.png", "a_1.jpeg", "b.PNG"):
        write(tmp_path / file)
    found = match_renders(tmp_path, "name", named)
    assert {name: path.name for name, path in found.items()} == {"a_0": "0.png", "a_1": "a_1.jpeg", "b": "b.PNG"}


def test_numbered_files_are_the_views_in_order_when_asked(tmp_path: Path) -> None:
    for number in (9, 10, 11):
        write(tmp_path / f"{number}.png")
    found = match_renders(tmp_path, "order", views())
    assert {name: path.stem for name, path in found.items()} == {"view1": "9", "view2": "10", "view3": "11"}
    with pytest.raises(RendersError, match="3 views without a file: view1, view2, view3"):
        match_renders(tmp_path, "name", views())
    write(tmp_path / "12.png")
    with pytest.raises(RendersError, match=r"1 files without a view: 12\.png"):
        match_renders(tmp_path, "order", views())


def test_two_files_of_one_view_are_named(tmp_path: Path) -> None:
    for file in ("view1.png", "view1.jpg", "view2.png", "view3.png"):
        write(tmp_path / file)
    with pytest.raises(RendersError, match=r"1 files of a view that another file is for: view1\.png"):
        match_renders(tmp_path, "name", views())


def test_arrays_are_taken_as_floats_as_they_are(tmp_path: Path) -> None:
    values = np.linspace(-0.25, 1.5, WIDTH * HEIGHT * 3, dtype=np.float32).reshape(HEIGHT, WIDTH, 3)
    np.save(tmp_path / "view1.npy", values)
    assert torch.equal(read_render(tmp_path / "view1.npy", BLACK), torch.from_numpy(values))
    np.save(tmp_path / "bytes.npy", np.full((4, 4, 3), 51, np.uint8))
    assert read_render(tmp_path / "bytes.npy", BLACK).unique().item() == pytest.approx(0.2)
    values[0, 0, 0] = np.nan
    np.save(tmp_path / "view1.npy", values)
    with pytest.raises(RendersError, match="of its values are not finite"):
        read_render(tmp_path / "view1.npy", BLACK)


def test_arrays_of_bytes_as_floats_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "view1.npy", np.full((4, 4, 3), 90, np.float32))
    with pytest.raises(RendersError, match=r"view1\.npy: its values average 90, expected sRGB in \[0, 1\]"):
        read_render(tmp_path / "view1.npy", BLACK)


def test_arrays_that_are_no_pictures_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "view1.npy", np.zeros((3, HEIGHT, WIDTH), np.float32))
    np.save(tmp_path / "view2.npy", np.zeros((HEIGHT, WIDTH, 3), np.int64))
    write(tmp_path / "view3.jpg", mode="CMYK")
    with pytest.raises(RendersError) as caught:
        match_renders(tmp_path, "name", views())
    assert "view1.npy: has shape (3, 24, 32), expected (24, 32, 3)" in str(caught.value)
    assert "view2.npy: holds int64, expected floats in [0, 1] or bytes" in str(caught.value)
    assert "view3.jpg: has pixels of mode CMYK" in str(caught.value)


def test_transparent_pictures_are_laid_on_the_background(tmp_path: Path) -> None:
    Image.new("RGBA", (WIDTH, HEIGHT), (255, 0, 0, 0)).save(tmp_path / "a.png")
    assert read_render(tmp_path / "a.png", torch.ones(3)).min() == 1
    assert read_render(tmp_path / "a.png", BLACK).max() == 0


def test_a_picture_that_ends_early_is_named_once(tmp_path: Path) -> None:
    Image.effect_noise((WIDTH, HEIGHT), 80).save(tmp_path / "a.png")
    content = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(content[: len(content) // 2])
    with pytest.raises(RendersError, match=r"a\.png: cannot be decoded") as caught:
        read_render(tmp_path / "a.png", BLACK)
    assert str(caught.value).count("a.png") == 1
