"""The pages that `make api` writes of the core and the contracts."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import envgs_bench.core

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_every_public_name_has_its_place_and_nothing_is_warned_of(tmp_path: Path) -> None:
    pytest.importorskip("pdoc", reason="the optional extra `api`")
    installed = [f"VENV={sys.prefix}", "-o", f"{sys.prefix}/.installed"]
    made = subprocess.run(
        ["make", "api", *installed, f"API={tmp_path}"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert made.stderr == ""
    core = (tmp_path / "envgs_bench" / "core.html").read_text(encoding="utf-8")
    assert [name for name in envgs_bench.core.__all__ if f'<section id="{name}">' not in core] == []
    for attribute in ("GaussianSet.means", "Camera.intrinsics", "Rendering.normal", "Statistics.weights", "View.image"):
        described = core.partition(f'<div id="{attribute}"')[2].partition('<div id="')[0]
        assert re.search(r'class="docstring"><p>\[', described), f"{attribute}: its shape is not shown"
    pages = {str(page.relative_to(tmp_path).with_suffix("")).replace("/", ".") for page in tmp_path.rglob("*.html")}
    assert {"envgs_bench.records", "envgs_bench.settings", "envgs_bench.methods.method"} <= pages
