"""Messages lead to pages of the documentation, and these are there."""

from __future__ import annotations

from pathlib import Path

import pytest
from fakes.runs import run_here

from envgs_bench.cli.main import main
from envgs_bench.pages import FAILED, OF_ERRORS, page


@pytest.mark.parametrize("name", sorted({FAILED, *OF_ERRORS.values()}))
def test_a_page_that_messages_lead_to_is_there(name: str) -> None:
    assert Path(page(name)).read_text(encoding="utf-8").startswith("# ")


def led_to(text: str) -> list[str]:
    return [line.partition("what helps: ")[2] for line in text.splitlines() if "what helps: " in line]


def test_data_that_cannot_be_loaded_lead_to_data_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "sparse").mkdir()
    assert main(["export", "dataset=colmap", f"dataset.root={tmp_path}", "--out", str(tmp_path / "out")]) != 0
    assert led_to(capsys.readouterr().err) == [page("reference/data_sets")]


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


def test_doctor_leads_to_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    main(["doctor"])
    assert led_to(capsys.readouterr().out) == [page(FAILED)]
