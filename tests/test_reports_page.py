"""The page: opens offline in a browser, its controls work, and nothing that a record says runs as a script."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from reports_runs import record, run_folder, write_failure, write_record, write_runs

from envgs_bench.reports import Report, build_report
from envgs_bench.reports.layout import entries, headings
from envgs_bench.reports.pareto import front, points

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = """<img src=x onerror="window.hacked=1"></script><script>window.hacked=1</script>'"&`|\\"""
PROBE = """
window.seen = {errors: []};
window.addEventListener("error", (event) => window.seen.errors.push(String(event.message)));
document.addEventListener("securitypolicyviolation", (event) => window.seen.errors.push(event.blockedURI));
window.addEventListener("load", () => setTimeout(() => {
  const seen = window.seen;
  const one = (selector) => document.querySelector(selector);
  const change = (selector, value) => {
    const control = one(selector);
    if (control.type === "checkbox") control.checked = value; else control.value = value;
    control.dispatchEvent(new Event("change"));
  };
  const traces = () => one(".chart").data.length;
  seen.front = one(".chart").dataset.front;
  seen.all = traces();
  change(".chart-dominated", false);
  seen.undominated = traces();
  change(".chart-y", "psnr_reflective");
  seen.yTitle = one(".chart").layout.yaxis.title.text;
  change(".chart-log", false);
  seen.xType = one(".chart").layout.xaxis.type;
  seen.curves = one(".curves").data.filter((trace) => trace.showlegend).map((trace) => trace.name);
  const split = one(".split");
  split.value = 20;
  split.dispatchEvent(new Event("input"));
  seen.split = one(".stage").style.getPropertyValue("--split");
  seen.picture = one(".img-b").getAttribute("src");
  seen.loaded = one(".img-a").naturalWidth;
  change(".viewer-mode", "difference");
  seen.mode = one(".stage").dataset.mode;
  change(".viewer-zoom", "4");
  seen.zoom = one(".stage").style.getPropertyValue("--zoom");
  change(".viewer-b", "3dgs");
  seen.chosen = one(".tag-b").textContent;
  seen.pressed = one('.strip [aria-pressed="true"] b').textContent;
  const buttons = Array.from(document.querySelectorAll('[data-title="toy/chrome_room"] .sort'));
  const heading = buttons.find((button) => button.textContent.startsWith("PSNR"));
  const order = () => Array.from(heading.closest("table").tBodies[0].rows).map((row) => row.cells[0].textContent);
  heading.click();
  seen.ascending = order();
  heading.click();
  seen.descending = order();
  seen.hacked = window.hacked === 1;
  seen.scripts = document.scripts.length;
  seen.resources = performance.getEntriesByType("resource").map((entry) => entry.name);
  const output = document.createElement("pre");
  output.id = "seen";
  output.textContent = "SEEN" + encodeURIComponent(JSON.stringify(seen)) + "SEEN";
  document.body.append(output);
}, 1500));
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    folder = tmp_path_factory.mktemp("page")
    write_runs(folder / "runs", seeds=(0, 1), size=(24, 32))
    write_failure(folder / "runs", "toy/chrome_room", "single_set", 0, "diverged", "the loss was not finite")
    hostile: dict[str, Any] = {"method": HOSTILE, "overrides": [HOSTILE], "dataset": "toy/chrome_room"}
    write_record(folder / "runs/hostile", record("toy/chrome_room", "other", 0) | hostile)
    error = {"type": HOSTILE, "message": HOSTILE, "log_tail": HOSTILE}
    failed = hostile | {"status": "failed", "error": error, "dataset": HOSTILE}
    write_record(folder / "runs/failed", record("toy/chrome_room", "other", 1) | failed)
    broken = run_folder(folder / "runs", "toy/chrome_room", "<b>broken", 9)
    write_record(broken, record("toy/chrome_room", "other", 2) | {"status": HOSTILE})
    return build_report(folder / "runs", folder / "out")


class Page(HTMLParser):
    """Tags with their attributes, and the results tables as text."""

    def __init__(self, html: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self._table: list[list[str]] | None = None
        self._in_cell = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append((tag, given))
        if tag == "table" and given.get("class") == "results":
            self._table = self.tables.setdefault(given["data-title"] or "", [])
        elif self._table is not None and tag == "tr":
            self._table.append([])
        elif self._table is not None and tag in ("td", "th"):
            self._table[-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        self._in_cell = self._in_cell and tag not in ("td", "th")
        if tag == "table":
            self._table = None

    def handle_data(self, data: str) -> None:
        if self._table is not None and self._in_cell:
            self._table[-1][-1] += data


def test_the_page_prints_the_tables_numbers(report: Report) -> None:
    page = Page(report.page.read_text())
    for table in report.sections[0].all_tables:
        head, *body = page.tables[table.title]
        assert [text.strip().replace("\N{NO-BREAK SPACE}", " ") for text in head] == headings(table)
        for row, cells in zip(table.rows, body, strict=True):
            for entry, cell in zip(entries(table, row), cells, strict=True):
                mark = str(entry.rank or "")
                value, sign, spread = entry.text.partition(" ± ") if entry.number else (entry.text, "", "")
                expected = value + mark + (f" ± {spread}" if sign else "") + (" ≈" if entry.tied else "")
                assert " ".join(cell.split()) == " ".join(expected.split())


def test_nothing_is_fetched_from_elsewhere(report: Report) -> None:
    page = Page(report.page.read_text())
    places = [place for _, given in page.tags for key in ("src", "href") if (place := given.get(key))]
    assert places
    for place in places:
        assert not re.match(r"(?i)([a-z]+:)?//", place), place
        if not place.startswith(("#", "data:")):
            assert (report.out / place).is_file(), place
    lazy = [
        given.get("loading") for tag, given in page.tags if tag == "img" and "pictures/" in (given.get("src") or "")
    ]
    assert set(lazy) == {"lazy"}


def test_text_of_records_is_escaped(report: Report) -> None:
    html = report.page.read_text()
    page = Page(html)
    scripts = [given for tag, given in page.tags if tag == "script"]
    assert [given.get("src", "") for given in scripts] == [
        f"assets/{name}" for name in ("plotly.min.js", "data.js", "tables.js", "charts.js", "viewer.js")
    ]
    assert not any(key.startswith("on") for _, given in page.tags for key in given)
    assert "&lt;img src=x onerror=" in html


def test_the_page_says_where_numbers_came_from(report: Report) -> None:
    html = report.page.read_text()
    for words in (
        "5e1f00d0c0ffee11",
        "0123456789abcdef0123456789abcdef01234567",
        "torch 2.13.0",
        "every view warmed up once",
        "envgs-bench run -m method=envgs dataset=toy/chrome_room seed=0,1",
        "step 413  loss nan",
        "no VGG-16 weights on this machine",
    ):
        assert words in html, words


def test_the_data_are_plain_javascript(report: Report) -> None:
    text = (report.out / "assets/data.js").read_text()
    data = json.loads(text.removeprefix("window.REPORT = ").removesuffix(";\n"))
    assert len(data["sections"]) == len(report.sections)


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
def test_the_page_works_in_a_browser_without_network(report: Report, tmp_path: Path) -> None:
    shutil.copytree(report.out, tmp_path / "page")
    (tmp_path / "page/assets/probe.js").write_text(PROBE)
    page = tmp_path / "page/index.html"
    page.write_text(page.read_text().replace("<title>", '<script src="assets/probe.js"></script><title>', 1))
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    flags += " --disable-component-update --disable-sync --virtual-time-budget=10000 --dump-dom"
    flags += " --enable-logging=stderr --window-size=1300,1000"
    blocked = "--host-resolver-rules=MAP * ~NOTFOUND"
    command = [str(CHROMIUM), *flags.split(), blocked, f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    found = re.search(r'<pre id="seen">SEEN(.*?)SEEN', run.stdout)
    assert found, run.stderr[-2000:]
    seen = json.loads(unquote(found.group(1)))
    assert seen["errors"] == []
    assert "CONSOLE" not in run.stderr, run.stderr
    assert not seen["hacked"]
    assert seen["scripts"] == 6
    assert seen["resources"] == []  # what is fetched from anywhere but files
    table = next(t for t in report.sections[0].tables if t.title == "toy/chrome_room")
    speed, psnr = (next(c for c in table.columns if c.key == key) for key in ("frame_ms", "psnr"))
    assert seen["front"].split("|") == [p.label for p in front(points(table, speed, psnr), speed, psnr)]
    assert seen["undominated"] < seen["all"]
    assert seen["yTitle"].startswith("PSNR of the reflective region, dB")
    assert seen["xType"] == "linear"
    assert seen["curves"] == ["3dgs", "2dgs", "envmap", "envgs"]
    assert seen["split"] == "20%"
    assert seen["loaded"] == 32
    assert seen["mode"] == "difference"
    assert seen["zoom"] == "4"
    assert seen["chosen"] == seen["pressed"] == "3dgs"
    scored = sorted((row for row in table.rows if row.done), key=lambda row: row.cells["psnr"].mean or 0)
    by_psnr = [row.method for row in scored]
    unscored = [row.method for row in table.rows if not row.done]
    assert seen["ascending"] == by_psnr + unscored
    assert seen["descending"] == by_psnr[::-1] + unscored
