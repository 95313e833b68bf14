"""The notebook runs from its first cell to its last, with fewer steps."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "envgs_bench" / "docs" / "demo.ipynb"


def cells() -> list[str]:
    content = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    assert all(cell["outputs"] == [] for cell in content["cells"] if cell["cell_type"] == "code")  # stored without
    return ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path) -> None:
    script = tmp_path / "cells.py"
    script.write_text("\n\n".join(cells()), encoding="utf-8")
    given = {"ENVGS_BENCH_STEPS": "16", "ENVGS_BENCH_OUT": str(tmp_path / "out"), "MPLBACKEND": "Agg"}
    result = subprocess.run([sys.executable, script], env={**os.environ, **given}, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr[-3000:]
    assert "| envgs | 1/1 |" in result.stdout
    assert (tmp_path / "out" / "index.html").is_file()


def test_every_cell_of_the_notebook_compiles() -> None:
    assert len(cells()) > 4
    for number, cell in enumerate(cells()):
        compile(cell, f"cell {number}", "exec")
