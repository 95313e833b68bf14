"""The reports' rooms import in one direction, and nothing of the harness but its contracts."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import envgs_bench
from envgs_bench import reports

ROOT = Path(reports.__file__).parent
MAY_IMPORT = {
    "numbers": {"numbers"},
    "tables": {"numbers", "tables"},
    "charts": {"numbers", "tables", "charts"},
    "pictures": {"numbers", "tables", "pictures"},
    "page": {"numbers", "tables", "charts", "pictures", "page"},
}
CONTRACTS = {path.stem for path in Path(envgs_bench.__file__).parent.glob("*.py")} - {"testing"}


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """(dots before the name, module) of each `from … import` of the file, and (0, module) of each `import`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            yield node.level, node.module or ""
        elif isinstance(node, ast.Import):
            yield from ((0, alias.name) for alias in node.names)


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_only_those_before_it(room: str) -> None:
    found = {
        module.partition(".")[0] for path in (ROOT / room).glob("*.py") for level, module in imports(path) if level == 2
    }
    assert found <= MAY_IMPORT[room]


def test_reports_know_records_and_never_a_model() -> None:
    files = list(ROOT.rglob("*.py"))
    assert {path.parent.name for path in files} == {ROOT.name, *MAY_IMPORT}
    modules = {module for path in files for level, module in imports(path) if level == 0}
    assert {module.split(".")[1] for module in modules if module.startswith("envgs_bench.")} <= CONTRACTS
    assert "torch" not in {module.partition(".")[0] for module in modules}
