"""Rooms import in one direction, as docs/reference/architecture.md draws it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import envgs_bench
from envgs_bench import datasets, methods, metrics, reports
from envgs_bench.runs.identity import RESULT_CODE

PACKAGE = Path(envgs_bench.__file__).parent
CONTRACTS = {path.stem for path in PACKAGE.glob("*.py")} - {"testing"}
RUNS = {"core", "datasets", "diagnosis", "methods", "metrics", "programs", "stages", "runs"}
MAY_IMPORT = {  # besides contracts and itself
    "core": set(),
    "datasets": {"core"},
    "methods": {"core"},
    "diagnosis": {"core"},
    "metrics": {"core"},
    "programs": {"core", "methods"},
    "stages": {"core", "datasets", "diagnosis", "methods", "metrics", "programs"},
    "loggers": {"stages"},
    "runs": {*RUNS, "loggers"},
    "stored": RUNS,
    "published": {"datasets"},
    "viewing": {*RUNS, "stored"},
    "bench": {"core", "diagnosis", "methods", "metrics", "stages", "stored", "reports"},
    "reports": set(),
}
ELSEWHERE = {module.__name__.rpartition(".")[2]: module for module in (datasets, methods, metrics, reports)}
ROOMS_OF_REPORTS = {
    "numbers": {"numbers"},
    "tables": {"numbers", "tables"},
    "charts": {"numbers", "tables", "charts"},
    "pictures": {"numbers", "tables", "pictures"},
    "page": {"numbers", "tables", "charts", "pictures", "page"},
    "kept": {"numbers", "tables", "kept"},
}
STUDIES = sorted(path.parent.name for path in Path(reports.__file__ or "").parent.glob("studies/*/study.py"))


def folder_of(room: str) -> Path:
    return Path(ELSEWHERE[room].__file__ or "").parent if room in ELSEWHERE else PACKAGE / room


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """(dots before the name, module) of each `from … import` of the file, and (0, module) of each `import`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            yield node.level, node.module or ""
        elif isinstance(node, ast.Import):
            yield from ((0, alias.name) for alias in node.names)


def rooms_imported(room: str) -> set[str]:
    """The rooms and contracts that a room's files name in absolute imports."""
    modules = {module for path in folder_of(room).rglob("*.py") for level, module in imports(path) if level == 0}
    return {module.split(".")[1] for module in modules if module.startswith("envgs_bench.")} - {room}


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_only_those_that_it_may(room: str) -> None:
    assert rooms_imported(room) <= MAY_IMPORT[room] | CONTRACTS


def test_every_room_is_in_the_order() -> None:
    inside = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert inside | set(ELSEWHERE) == {*MAY_IMPORT, "cli"}


def test_code_that_makes_results_imports_only_what_a_runs_identity_hashes() -> None:
    """A hash of these rooms' sources stands in every run's name: code of another room could change a result unseen."""
    assert "stages" in RESULT_CODE
    for room in RESULT_CODE:
        assert rooms_imported(room) <= {*RESULT_CODE, *CONTRACTS}


@pytest.mark.parametrize("room", ROOMS_OF_REPORTS)
def test_the_rooms_of_reports_import_only_those_before_them(room: str) -> None:
    modules = [module for path in (folder_of("reports") / room).glob("*.py") for n, module in imports(path) if n == 2]
    assert {module.partition(".")[0] for module in modules} <= ROOMS_OF_REPORTS[room]


@pytest.mark.parametrize("study", STUDIES)
def test_a_study_imports_no_other_and_no_room_before_the_studies_imports_one(study: str) -> None:
    files = (folder_of("reports") / "studies" / study).glob("*.py")
    above = {(n, module.partition(".")[0]) for path in files for n, module in imports(path) if n > 1}
    assert above <= {(2, "study"), *((3, room) for room in ROOMS_OF_REPORTS)}


def test_reports_never_see_a_model() -> None:
    files = list(folder_of("reports").rglob("*.py"))
    assert {path.parent.name for path in files} == {"reports", "studies", *ROOMS_OF_REPORTS, *STUDIES}
    assert "torch" not in {module.partition(".")[0] for path in files for _, module in imports(path)}
