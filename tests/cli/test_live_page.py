"""The page of a sweep: there from the beginning, renewed as runs end, and no more under way when they have."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from fakes.runs import records, run, run_here, set_environment

from envgs_bench import reports
from envgs_bench.cli.live_page import PAGE_VARIABLE, renew_page
from envgs_bench.cli.sweep_summary import SUMMARY_VARIABLE, SWEEP_VARIABLE, Sweep, enter, time_left, under_way
from envgs_bench.runs.outcome import Outcome

WAITING = "1 of 2 runs have ended: this page fills as the others do."


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """What the page in `page` was, whenever it was renewed; it holds how far the sweep has come, and no more."""
    set_environment(monkeypatch)
    pages: list[str] = []

    def build(runs: Path, out: Path, under_way: str) -> None:
        assert (runs, out) == (tmp_path / "runs", tmp_path / "page")
        pages.append((out / "index.html").read_text())
        (out / "index.html").write_text(f'<meta http-equiv="refresh" content="5">{under_way}' if under_way else "")

    monkeypatch.setattr(reports, "build_report", build)
    return pages


def test_a_page_fills_as_runs_end(tmp_path: Path, seen: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page" / "index.html"
    sweep = ("seed=0,1", f"page={page.parent}")
    assert run_here(tmp_path / "runs", *sweep, flags=("-m",)) == 0
    shown = capsys.readouterr().err
    assert f"the page fills as runs end: {page}" in shown[: shown.index("seed 0")]
    first, second = seen
    assert "No run has ended yet" in first
    assert WAITING in second
    assert page.read_text() == ""
    assert shown.endswith(f"tables, charts and a page: {page}\n")
    assert run_here(tmp_path / "runs", *sweep, flags=("-m",)) == 0  # all reused, and shown once
    assert len(seen) == 3


def test_a_sweep_that_ends_early_leaves_no_page_that_waits(
    tmp_path: Path, seen: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("envgs_bench.cli.application.under_way", lambda: WAITING)  # as where the second never comes
    assert run_here(tmp_path / "runs", f"page={tmp_path / 'page'}") == 0
    assert WAITING in seen[-1]
    assert (tmp_path / "page" / "index.html").read_text() == ""


def test_a_page_that_cannot_be_written_stops_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_environment(monkeypatch)
    monkeypatch.setattr(reports, "build_report", lambda *_, **__: 1 / 0)
    assert run_here(tmp_path / "runs", f"page={tmp_path / 'page'}") == 0
    assert f"the page in {tmp_path / 'page'} could not be written: division by zero" in capsys.readouterr().err
    assert not (tmp_path / "page" / "index.html").exists()


def test_of_two_that_renew_a_page_one_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PAGE_VARIABLE, str(tmp_path))
    monkeypatch.setattr("envgs_bench.file_lock.PATIENCE", 0.01)
    first, other, steps = threading.Event(), threading.Event(), []

    def build(_: Path, __: Path, under_way: str) -> None:
        steps.append(under_way)
        first.set()
        other.wait(0.2)  # it never comes as long as this one writes
        steps.append(under_way)

    def come() -> str:
        other.set()
        return "second"

    def second() -> None:
        assert first.wait(20)
        renew_page(tmp_path, come)

    monkeypatch.setattr(reports, "build_report", build)
    with ThreadPoolExecutor(2) as pool:
        for ended in [pool.submit(renew_page, tmp_path, lambda: "first"), pool.submit(second)]:
            ended.result()
    assert steps == ["first", "first", "second", "second"]
    assert list(tmp_path.iterdir()) == []  # no lock is left


def test_an_interrupted_job_is_none_that_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SUMMARY_VARIABLE, str(tmp_path / "outcomes.jsonl"))
    monkeypatch.setenv(SWEEP_VARIABLE, "")
    Sweep(0, time.time() - 20, jobs=4).announce()
    done = Outcome("tiny", "fake", 0, "ok", "ran", "", None, None, None, "runs/seed0-1")
    for status in ("ok", "interrupted", "ok"):
        enter(replace(done, status=status))
    assert time_left() == "2 of 4 jobs done in 20 s, 20 s left if the others take as long on average"
    assert under_way().startswith("2 of 4 runs have ended")


def test_a_page_of_something_else_ends_the_call_before_the_first_job(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "index.html").write_text("my own page")
    assert run(tmp_path / "runs", f"page={tmp_path}") == 2
    assert f"page={tmp_path}: holds an index.html of something else" in capsys.readouterr().err
    assert (tmp_path / "index.html").read_text() == "my own page"
    assert records(tmp_path) == []
