"""The reports' pictures: which views, which window, whose error maps, and what happens where there are none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reports_runs import METHODS, ball_in_a_box, record, run_folder, write_failure, write_record, write_runs
from skimage.feature import match_template

from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.page.data import _shot
from envgs_bench.reports.pictures.error_maps import colored_flip_map, draw_error_maps
from envgs_bench.reports.pictures.figure import MOST_BYTES, FigureError, draw_figure
from envgs_bench.reports.pictures.gallery import Gallery, copy_pictures, galleries, slug
from envgs_bench.reports.pictures.sheets import CELL, GAP, HEAD, MARGIN, draw_sheets, zoom_window
from envgs_bench.reports.tables.sections import split_sections
from envgs_bench.run_folder import read_png_if_any

ROOM = "toy/chrome_room"


def gallery_of(folder: Path) -> Gallery:
    (gallery,) = galleries(split_sections(read_runs(folder)[0])[0])
    return gallery


def test_the_worst_and_the_median_view_lead(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("3dgs", "envgs"), seeds=(0, 1))
    gallery = gallery_of(tmp_path)
    assert [(shot.view, shot.roles) for shot in gallery.shots] == [
        ("000", ("worst",)),
        ("001", ()),
        ("002", ("median",)),
        ("003", ()),
        ("004", ()),
    ]
    assert gallery.methods == ("3dgs", "envgs")
    assert list(gallery.shots[0].layers["envgs"]) == ["error", "base", "reflection", "beta", "normal"]
    assert gallery.shots[0].psnr["envgs"] == record(ROOM, "envgs", 0)["metrics"]["per_view"][0]["psnr"]


def test_sheets_have_a_column_a_method_and_name_what_failed(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,))
    write_failure(tmp_path / "runs", ROOM, "single_set", 0, "diverged", "nan")
    gallery = gallery_of(tmp_path / "runs")
    assert gallery.missing == {"single_set": "diverged"}
    copy_pictures(gallery, tmp_path / "out", "pictures/room")
    sheets = draw_sheets(gallery, tmp_path / "out", "pictures/room")
    assert list(sheets) == [
        "worst view 000: all methods",
        "worst view 000: layers",
        "median view 002: all methods",
        "median view 002: layers",
    ]
    for path in sheets.values():
        with Image.open(tmp_path / "out" / path) as sheet:
            assert sheet.width > CELL * (len(METHODS) + 1)
    copies = [tmp_path / "out" / name for name in gallery.files.values()]
    assert len(copies) == 5 * (1 + len(METHODS) + 2 * 5)
    assert all(copy.read_bytes() == source.read_bytes() for source, copy in zip(gallery.files, copies, strict=True))


@pytest.mark.parametrize("ending", ["webp", "jpg"])
def test_a_figure_has_two_views_and_their_windows_pixel_by_pixel(tmp_path: Path, ending: str) -> None:
    write_runs(tmp_path / "runs", methods=("2dgs", "envgs"), seeds=(0,))
    gallery = draw_figure(tmp_path / "runs", tmp_path / f"figure.{ending}")
    assert gallery.methods == ("2dgs", "envgs")
    assert (tmp_path / f"figure.{ending}").stat().st_size <= MOST_BYTES
    with Image.open(tmp_path / f"figure.{ending}") as figure:
        drawn = np.asarray(figure.convert("RGB"), dtype=np.float64).mean(-1)
    (shot,) = [shot for shot in gallery.shots if "worst" in shot.roles]
    target = read_png_if_any(shot.target)
    assert target is not None
    height, pixel = CELL * 60 // 80, 14  # of 80 columns 24 are shown, each pixel as 14 by 14
    top = MARGIN + HEAD + height + GAP
    window = drawn[top : top + 18 * pixel, MARGIN : MARGIN + 24 * pixel]
    window = window.reshape(18, pixel, 24, pixel).mean((1, 3))
    assert match_template(target.mean(-1), window).max() > 0.95


def test_a_figure_is_of_one_data_set(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", (ROOM, "toy/sky_ball"), methods=("2dgs",), seeds=(0,))
    with pytest.raises(FigureError, match=r"found 2 that left pictures .toy/chrome_room, toy/sky_ball.: choose with"):
        draw_figure(tmp_path / "runs", tmp_path / "figure.webp")
    with pytest.raises(FigureError, match=r"ends in \.webp, \.jpg"):
        draw_figure(tmp_path / "runs", tmp_path / "figure.png", only=[ROOM])
    draw_figure(tmp_path / "runs", tmp_path / "figure.webp", only=[ROOM])


def test_normals_stand_beside_exact_normals_with_the_angle_between(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0,))
    run = run_folder(tmp_path / "runs", ROOM, "envgs", 0)
    content = json.loads((run / "record.json").read_text())
    content["metrics"]["per_view"][0]["normal_degrees"] = 7.25
    (run / "record.json").write_text(json.dumps(content))
    (run / "targets/normal").mkdir()
    Image.new("RGB", (80, 60), (1, 2, 250)).save(run / "targets/normal/000.png")
    gallery = gallery_of(tmp_path / "runs")
    shot = next(shot for shot in gallery.shots if shot.view == "000")
    assert shot.degrees == {"envgs": 7.25}
    assert shot.normal == run / "targets/normal/000.png"
    assert all(other.normal is None for other in gallery.shots if other is not shot)
    copy_pictures(gallery, tmp_path / "out", "pictures/room")
    sheets = draw_sheets(gallery, tmp_path / "out", "pictures/room")
    with Image.open(tmp_path / "out" / sheets["worst view 000: layers"]) as sheet:
        colors = sheet.convert("RGB").getcolors(1 << 24)
    assert (1, 2, 250) in {color for _, color in colors}  # in the row of the ground truth
    assert _shot(shot, gallery)["target"].keys() == {"image", "normal"}


def test_damaged_and_missing_pictures_are_not_fatal(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,))
    folder = run_folder(tmp_path / "runs", ROOM, "2dgs", 0)
    (folder / "renders" / "000.png").write_bytes(b"\x89PNG\r\n\x1a\n truncated")
    Image.new("RGB", (7, 5)).save(run_folder(tmp_path / "runs", ROOM, "3dgs", 0) / "renders" / "000.png")
    (run_folder(tmp_path / "runs", ROOM, "envmap", 0) / "renders" / "000.png").unlink()
    gallery = gallery_of(tmp_path / "runs")
    assert "envmap" not in gallery.shots[0].renders
    copy_pictures(gallery, tmp_path / "out", "pictures")
    draw_error_maps(gallery, tmp_path / "out")
    assert [method for view, method in gallery.flips if view == "000"] == ["envgs"]
    sheets = draw_sheets(gallery, tmp_path / "out", "pictures")
    assert all((tmp_path / "out" / path).is_file() for path in sheets.values())


def test_runs_without_pictures_have_no_gallery(tmp_path: Path) -> None:
    write_runs(tmp_path, pictures=False)
    assert galleries(split_sections(read_runs(tmp_path)[0])[0]) == []


def test_a_view_cannot_lead_out_of_its_folder(tmp_path: Path) -> None:
    run = run_folder(tmp_path, ROOM, "envgs", 0)
    content = record(ROOM, "envgs", 0)
    content["metrics"]["per_view"] = [{"view": "../../secret", "psnr": 20.0}]
    write_record(run, content)
    (run / "renders").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "secret.png")
    assert galleries(split_sections(read_runs(tmp_path)[0])[0]) == []


def test_a_name_becomes_a_harmless_file_name() -> None:
    assert slug("toy/chrome_room [views=24]") == "toy-chrome_room-views-24"
    assert slug("../..") == "unnamed"
    assert slug("<script>") == "script"


@pytest.mark.parametrize(("row", "column"), [(10, 15), (70, 100), (40, 50)])
def test_the_window_is_where_methods_differ(row: int, column: int) -> None:
    errors = [np.zeros((96, 128)), np.zeros((96, 128))]
    errors[1][row : row + 4, column : column + 4] = 1
    rows, columns = zoom_window(errors, np.ones((96, 128)))
    assert rows.start <= row
    assert row + 4 <= rows.stop <= 96
    assert columns.start <= column
    assert column + 4 <= columns.stop <= 128
    assert (rows.stop - rows.start, columns.stop - columns.start) == (30, 40)


def test_the_window_looks_at_reflections_where_they_are_known() -> None:
    errors = [np.zeros((96, 128)), np.ones((96, 128))]
    mask = np.zeros((96, 128))
    mask[60:80, 90:110] = 1
    rows, columns = zoom_window(errors, mask)
    assert mask[rows, columns].sum() == mask.sum()


def test_flip_maps_lie_beside_their_renders(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("3dgs", "envgs"), seeds=(0,))
    gallery = gallery_of(tmp_path / "runs")
    copy_pictures(gallery, tmp_path / "out", "pictures")
    draw_error_maps(gallery, tmp_path / "out")
    assert set(gallery.flips) == {(shot.view, method) for shot in gallery.shots for method in ("3dgs", "envgs")}
    shot = gallery.shots[0]
    render, target = read_png_if_any(shot.renders["envgs"]), read_png_if_any(shot.target)
    drawn = read_png_if_any(tmp_path / "out" / gallery.flips[shot.view, "envgs"]["flip"])
    assert render is not None
    assert target is not None
    np.testing.assert_allclose(drawn, 255 * colored_flip_map(render, target)[0], atol=0.51)


def test_flip_is_0_for_equal_pictures_and_large_for_opposite_ones() -> None:
    target = (255 * np.clip(ball_in_a_box((48, 64), 0.3)["base"], 0, 1)).astype(np.uint8)
    colors, same = colored_flip_map(target, target)
    assert same == 0
    assert colors.shape == (48, 64, 3)
    assert 0.3 < colored_flip_map(255 - target, target)[1] <= 1


def test_pictures_are_read_as_they_are(tmp_path: Path) -> None:
    pixels = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    Image.fromarray(pixels).save(tmp_path / "picture.png")
    np.testing.assert_array_equal(read_png_if_any(tmp_path / "picture.png"), pixels)
    assert read_png_if_any(tmp_path / "missing.png") is None
