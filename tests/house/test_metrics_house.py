"""Metrics' house: a metric is a file and a line of the registry; all others take it from there, or from records."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
import torch
from reports_runs import record, run_folder, write_record
from torch import Tensor

import envgs_bench
from envgs_bench import metrics, reports
from envgs_bench.metrics import Choices, Metric, get_protocol
from envgs_bench.metrics.registry import REGISTERED
from envgs_bench.parts import MetricCard
from envgs_bench.reports.numbers.cards import KNOWN
from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.page.data import write_data
from envgs_bench.reports.tables.columns import main_columns
from envgs_bench.reports.tables.sections import split_sections
from envgs_bench.stages.scoring import Pair, score_pairs

ROOMS = [Path(room.__file__ or "").parent for room in (metrics, reports)]
PACKAGE = Path(envgs_bench.__file__).parent


def largest(prediction: Tensor, target: Tensor, mask: Tensor | None, choices: Choices) -> float:
    """The largest error of a channel, in 8-bit levels."""
    error = 255 * (prediction - target).abs()
    return float((error if mask is None else error[mask]).max())


METRIC = Metric(
    MetricCard("largest error", 1, "lower", "levels", "of any pixel"),
    value=largest,
    definition=lambda _: "the largest error of a channel",
    corrected=True,
)


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    monkeypatch.setitem(REGISTERED, "largest", f"{__name__}:METRIC")


@pytest.mark.usefixtures("registered")
def test_a_line_of_the_registry_is_a_column_of_the_tables(tmp_path: Path) -> None:
    """Of two methods, off by 2 and by 4.2 levels, in the whole picture and in a region."""
    target = torch.full((16, 20, 3), 0.5)
    mask = torch.arange(20).expand(16, 20) < 8
    for method, levels in (("2dgs", 4.2), ("envgs", 2.0)):
        pair = Pair("000", target + levels / 255, target, {"reflective": mask})
        scores, masked = score_pairs([pair], get_protocol())
        parts = {
            "metrics": scores.model_dump(mode="json"),
            "masked": {region: each.model_dump(mode="json") for region, each in masked.items()},
        }
        content = record("toy/chrome_room", method, 0, **parts)
        write_record(run_folder(tmp_path / "runs", "toy/chrome_room", method, 0), content)
    (section,) = split_sections(read_runs(tmp_path / "runs")[0])
    for kind in ("subject", "regions"):
        (table,) = (table for table in section.tables if table.kind == kind)
        (column,) = (column for column in table.columns if column.metric == "largest")
        assert column.heading == "largest error ↓"
        found = {row.method: (row.cells[column.key].text, row.cells[column.key].rank) for row in table.rows}
        assert found == {"2dgs": ("4.2", 2), "envgs": ("2.0", 1)}
    data = write_data(tmp_path, [section], [[]])["sections"][0]["columns"]["largest"]
    assert data == {
        "title": "largest error",
        "axis": "largest error, levels",
        "better": "lower",
        "axis_of": "accuracy",
    }


@pytest.mark.usefixtures("registered")
def test_protocols_take_what_is_registered_and_keep_their_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    target = torch.full((16, 16, 3), 0.5)
    protocol = get_protocol("color_corrected")
    scores = protocol.score(target + 4 / 255, target)
    assert scores["largest"] == pytest.approx(4, abs=1e-3)
    assert scores["cc_largest"] == pytest.approx(0, abs=1e-3)
    assert protocol.description.count("the largest error of a channel") == 1
    assert protocol.cards["cc_largest"].corrected
    assert not protocol.cards["largest"].corrected
    taken = protocol.hash
    monkeypatch.delitem(REGISTERED, "largest")
    assert protocol.hash == taken
    assert "largest" not in protocol.metrics


def test_what_stands_in_for_cards_is_what_the_metrics_say() -> None:
    cards = get_protocol("color_corrected").cards
    assert {name: cards[name] for name in KNOWN} == KNOWN


@pytest.mark.parametrize("name", REGISTERED)
def test_names_are_keys_of_their_own(name: str) -> None:
    others = {column.key for column in main_columns({})} | {"view", "fraction", "per_view"}
    assert re.fullmatch("[a-z][a-z0-9_]*", name)
    assert not name.startswith("cc_")
    assert name not in others


def test_no_list_of_metrics_is_kept_elsewhere() -> None:
    """Three names in one file are a list. One is of what older records lack, one of what another program's format has;
    a study asks for metrics by name."""
    files = {f"{room.name}/{path.relative_to(room)}": path for room in ROOMS for path in room.rglob("*.py")}
    files |= {str(path.relative_to(PACKAGE)): path for path in PACKAGE.rglob("*.py")}
    found = set()
    for place, path in files.items():
        if place.startswith("reports/studies/"):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        strings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
        if len(strings & REGISTERED.keys()) > 2:
            found.add(place)
    assert found == {"metrics/registry.py", "reports/numbers/cards.py", "stored/nerfbaselines.py"}
