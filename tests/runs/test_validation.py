"""A run that is scored on validation views, from the command line to the record."""

from __future__ import annotations

from pathlib import Path

import pytest
from fakes.runs import only_folder, records, run_job_here, set_environment

from envgs_bench.metrics import get_protocol
from envgs_bench.settings import read_settings
from envgs_bench.stored.rescoring import redraw


def test_validation_views_are_scored_and_timed_in_place_of_test_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    assert run_job_here(tmp_path / "runs", "score_on=validation") == 0
    (record,) = records(tmp_path / "runs")
    assert record.scored_on == "validation"
    assert record.metrics is not None
    assert record.timing is not None
    scored = [row.view for row in record.metrics.per_view]
    assert scored == ["view2"]  # the first of the training views
    assert [row.view for row in record.timing.per_view] == scored
    folder = only_folder(tmp_path / "runs")
    assert [path.name for path in (folder / "renders").iterdir()] == ["view2.png"]
    assert read_settings(folder).dataset["validation"] is True
    again = redraw(folder, get_protocol("strict"), tmp_path / "again", "cpu")
    assert again.scored_on == "validation"
    assert again.metrics is not None
    assert [row.view for row in again.metrics.per_view] == scored
