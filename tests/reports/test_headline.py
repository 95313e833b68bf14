"""The page's first screen: the gain inside reflections with its interval, at what cost, from how many seeds, when."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reports_runs import run_folder, write_runs

from envgs_bench.reports import build_report
from envgs_bench.reports.numbers.headline import headline
from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.page.sizes import png_size
from envgs_bench.reports.tables.sections import split_sections

REFLECTS = {"3dgs": False, "2dgs": False, "envmap": True, "envgs": True}


def test_the_best_reflecting_method_stands_against_the_best_that_draws_no_reflections(tmp_path: Path) -> None:
    write_runs(tmp_path, ("toy/chrome_room", "toy/diffuse_room"), pictures=False)
    (section,) = split_sections(read_runs(tmp_path)[0])
    found = headline(section.numbers, "toy/chrome_room", REFLECTS)
    assert found is not None
    assert (found.method, found.baseline, found.region) == ("envgs", "3dgs", "reflective")
    of = {
        method: [run.record.masked["reflective"].scores["psnr"] for run in read_runs(tmp_path)[0]
                 if run.record.method == method and run.record.dataset == "toy/chrome_room"]
        for method in ("envgs", "3dgs")
    }  # fmt: skip
    assert float(found.gain.mean or 0) == pytest.approx(np.mean(np.subtract(of["envgs"], of["3dgs"])))
    assert found.gain.done == 3
    assert found.costs["frame_ms"][0] > found.costs["frame_ms"][1]
    elsewhere = headline(section.numbers, "toy/diffuse_room", REFLECTS)
    assert elsewhere is not None
    assert elsewhere.region == "full"  # nothing reflects there
    assert headline(section.numbers, "toy/chrome_room", {"envgs": True}) is None


def test_the_first_screen_says_it_in_words_and_shows_a_picture(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0, 1, 2), size=(24, 32))
    page = " ".join(build_report(tmp_path / "runs", tmp_path / "out").page.read_text().split())
    first = re.sub(r"<[^>]*>", "", page[: page.index('<nav class="bar"')])
    assert re.search(
        r"envgs gains \d\.\d\d dB \[\+\d\.\d\d, \+\d\.\d\d\] inside reflections against 3dgs on toy", first
    )
    assert re.search(
        r"at 6\.\d times the frame time \(\d+\.\d\d against \d+\.\d\d ms\), .* 3 seeds, 1,500 steps", first
    )
    assert re.search(r"Runs up to <time datetime=\"(\d{4}-\d\d-\d\d)\">\1<", page)
    (picture,) = re.findall(r'<img loading="lazy" src="([^"]*headline.png)" width="(\d+)" height="(\d+)"', page)
    assert png_size(tmp_path / "out" / picture[0]) == (int(picture[1]), int(picture[2]))


def test_one_seed_has_no_interval_and_says_so(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,), pictures=False)
    page = " ".join(build_report(tmp_path / "runs", tmp_path / "out").page.read_text().split())
    assert "dB</strong> inside reflections against 3dgs" in page
    assert "one seed: no interval, 1,500 steps" in page


def test_rows_lead_to_methods_and_runs_to_their_records_and_logs(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("2dgs", "envgs"), seeds=(0,), pictures=False)
    report = build_report(tmp_path / "runs", tmp_path / "out")
    page = report.page.read_text()
    assert re.search(r'<a href="#(section-0-method-\d)">envgs</a>', page)
    assert '<details class="part" id="section-0-method-1"' in page
    folder = run_folder(tmp_path / "runs", "toy/chrome_room", "envgs", 0)
    for name in ("record.json", "log.txt"):
        (link,) = [link for link in re.findall(r'href="(\.\./[^"]*)"', page) if f"/envgs/{folder.name}/{name}" in link]
        assert (report.out / link).resolve() == folder / name


def test_pictures_have_their_sizes(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,), size=(24, 32))
    page = build_report(tmp_path / "runs", tmp_path / "out").page.read_text()
    images = re.findall(r"<img [^>]*>", page)
    assert len(images) > 3
    assert all(re.search(r'width="[1-9]\d*" height="[1-9]\d*"', image) for image in images if "src=" in image)
    Image.new("RGB", (7, 5)).save(tmp_path / "a.png")
    assert png_size(tmp_path / "a.png") == (7, 5)
    assert png_size(tmp_path / "nowhere.png") == (0, 0)
