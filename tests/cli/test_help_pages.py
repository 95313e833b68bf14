"""Messages lead to pages of the documentation, and these are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fakes.runs import run_here

from envgs_bench.cli import examination
from envgs_bench.cli.main import main
from envgs_bench.pages import FAILED, OF_ERRORS, page

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", sorted({FAILED, *OF_ERRORS.values()}))
def test_a_page_that_messages_lead_to_is_there(name: str) -> None:
    assert Path(page(name)).read_text(encoding="utf-8").startswith("# ")


def led_to(text: str) -> list[str]:
    return [line.partition("what helps: ")[2] for line in text.splitlines() if "what helps: " in line]


def test_data_that_cannot_be_loaded_lead_to_data_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "sparse").mkdir()
    assert main(["export", "dataset=colmap", f"dataset.root={tmp_path}", "--out", str(tmp_path / "out")]) != 0
    assert led_to(capsys.readouterr().err) == [page("reference/data_sets")]


@pytest.mark.parametrize("lacking", ["folder", "images", "model"])
def test_data_that_no_run_can_start_with_lead_to_data_sets(
    lacking: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "data"
    if lacking != "folder":
        (root / "sparse" / "0").mkdir(parents=True)
    if lacking == "model":
        (root / "images").mkdir()
    assert run_here(tmp_path / "runs", "dataset=colmap", f"dataset.root={root}") == 2
    shown = capsys.readouterr().err
    assert str(root) in shown
    assert led_to(shown) == [page("reference/data_sets")]


def test_a_folder_without_records_leads_to_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path / "none")]) == 1
    assert led_to(capsys.readouterr().err) == [page("reference/records")]


def test_a_run_that_failed_leads_to_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(tmp_path, "method.kind=fakes.methods:Raises") == 1
    assert led_to(capsys.readouterr().out) == [page(FAILED)]
    assert main(["status", str(tmp_path)]) == 0
    assert led_to(capsys.readouterr().out) == [page(FAILED)]


def test_a_wrong_key_leads_to_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(tmp_path, "method.settings.nothing=1") == 2
    assert led_to(capsys.readouterr().err) == [page("reference/settings")]


def test_doctor_leads_to_what_to_do_about_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(examination, "available_backends", lambda: {"cpu": None, "cuda": "no GPU"})
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    main(["doctor"])
    assert led_to(capsys.readouterr().out) == [page(FAILED), page("explanation/core"), page("reference/measuring")]


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["status", "nowhere"], "reference/records"),
        (["list", "method", "nothing"], "reference/methods"),
        (["list", "dataset", "nothing"], "reference/data_sets"),
        (["export", "dataset.nothing=1", "--out", "out"], "reference/settings"),
        (["diagnose", "--seeds", "x", "--out", "out.csv"], "reference/sampled_scenes"),
        (["store", ".", "--layout", "ply", "--out", "out"], "reference/records"),
        (["render", ".", "--out", "film.webp"], "reference/records"),
        (["report", "nowhere", "--figure", "figure.png"], "reference/reports"),
        (["report", "nowhere", "--fill", "page.md"], FAILED),
    ],
)
def test_a_command_that_cannot_go_on_leads_to_a_page(
    arguments: list[str],
    found: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) != 0
    assert led_to(capsys.readouterr().err) == [page(found)]


def test_every_error_of_the_project_leads_somewhere() -> None:
    classes = re.compile(r"^class (\w+(?:Error|Unavailable))\(", re.MULTILINE)
    rooms = [ROOT / room for room in ("envgs_bench", "methods", "datasets", "metrics", "reports")]
    files = {path.resolve() for room in rooms for path in room.rglob("*.py")}
    assert {name for path in files for name in classes.findall(path.read_text(encoding="utf-8"))} - {
        *OF_ERRORS
    } == set()
