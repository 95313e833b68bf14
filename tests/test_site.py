"""The pages that `make docs` writes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import envgs_bench.core

DOCS = Path(__file__).parents[1] / "envgs_bench" / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built pages; a warning fails."""
    pytest.importorskip("sphinx", reason="the optional extra `docs`")
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", DOCS / "site", DOCS, out]
    built = subprocess.run(command, capture_output=True, text=True)
    assert (built.returncode, built.stderr) == (0, "")
    return out


@pytest.mark.slow
def test_every_public_name_of_the_core_has_its_place_and_tensors_their_shapes(site: Path) -> None:
    core = (site / "reference" / "api" / "core.html").read_text(encoding="utf-8")
    assert [name for name in envgs_bench.core.__all__ if f'id="envgs_bench.core.{name}"' not in core] == []
    for attribute in ("GaussianSet.means", "Camera.intrinsics", "Rendering.normal", "Statistics.weights", "View.image"):
        described = core.partition(f'id="envgs_bench.core.{attribute}"')[2].partition("</dl>")[0]
        assert re.search(r"<dd><p>\[", described), f"{attribute}: its shape is not shown"


@pytest.mark.slow
def test_nothing_of_a_page_is_fetched_from_elsewhere(site: Path) -> None:
    fetched = re.compile(r'<(?:script|img|link)[^>]*(?:src|href)="(?:https?:)?//')
    assert [page.name for page in site.rglob("*.html") if fetched.search(page.read_text(encoding="utf-8"))] == []


@pytest.mark.slow
def test_search_knows_the_pages_and_not_the_notebook(site: Path) -> None:
    index = json.loads(
        (site / "searchindex.js").read_text(encoding="utf-8").removeprefix("Search.setIndex(").removesuffix(")")
    )
    notebook = {number for number, page in enumerate(index["docnames"]) if page.startswith("notebook/2")}
    found = {word: {pages} if isinstance(pages, int) else set(pages) for word, pages in index["terms"].items()}
    assert notebook
    assert [word for word, pages in found.items() if pages & notebook] == []
    assert {index["titles"][number] for number in notebook} == {""}
    assert index["docnames"].index("reference/methods") in found["2dgs_lean"]
