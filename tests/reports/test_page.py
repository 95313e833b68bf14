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
from reports_runs import chapter, record, run_folder, write_failure, write_record, write_runs

from envgs_bench.cli.main import main
from envgs_bench.reports import Report, build_report
from envgs_bench.reports.charts.pareto import front, points
from envgs_bench.reports.page.html import SCRIPTS
from envgs_bench.reports.studies.ablation_ladder.study import AblationLadders
from envgs_bench.reports.tables.columns import FRAME_MS, PSNR
from envgs_bench.reports.tables.entries import entries, headings
from envgs_bench.reports.tables.table import Table

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
HOSTILE = """<img src=x onerror="window.hacked=1"></script><script>window.hacked=1</script>'"&`|\\"""
PROBE = """
window.seen = {errors: []};
window.addEventListener("error", (event) => window.seen.errors.push(String(event.message)));
window.addEventListener("unhandledrejection", (event) => window.seen.errors.push(String(event.reason)));
document.addEventListener("securitypolicyviolation", (event) => window.seen.errors.push(event.blockedURI));
const one = (selector) => document.querySelector(selector);
const all = (selector) => Array.from(document.querySelectorAll(selector));
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const change = (selector, value) => {
  const control = one(selector);
  if (control.type === "checkbox") control.checked = value; else control.value = value;
  control.dispatchEvent(new Event("change"));
};
const press = (node, key) => node.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true}));
const marks = () => one(".chart").data.filter((trace) => trace.name).map((trace) => trace.name);
const listed = (method) => all(".method-list li").find((item) => item.querySelector(".pick").title === method);

async function probe(seen) {
  await wait(1500);
  seen.subject = one(".chart-subject").selectedOptions[0].text;
  seen.front = one(".chart").dataset.front.split("|");
  seen.symbols = Object.fromEntries(one(".chart").data.filter((t) => t.name).map((t) => [t.name, t.marker.symbol]));
  seen.whiskers = one(".chart").data.filter((t) => t.name).every((t) => t.error_y.array[0] > 0);
  seen.dotted = one(".chart").data.filter((t) => t.line && t.line.dash === "dot").length;
  seen.all = marks();
  change(".chart-dominated", false);
  seen.undominated = marks();
  change(".chart-dominated", true);
  change(".chart-failed", false);
  seen.unfailed = marks();
  change(".chart-failed", true);
  const box = listed("3dgs").querySelector("input");
  box.focus();
  box.click();
  seen.without = marks();
  seen.focusStays = document.activeElement.dataset.key;
  one(".chart-none").click();
  seen.none = marks();
  one(".chart-all").click();
  seen.again = marks();
  listed("envgs").querySelector(".pick").focus();
  await wait(200);
  seen.highlight = one(".chart").dataset.highlight;
  document.activeElement.click();
  seen.about = one(".about").textContent;
  change(".chart-y", "psnr_reflective");
  seen.yTitle = one(".chart").layout.yaxis.title.text;
  seen.static = one(".static-pdf").getAttribute("href");
  change(".chart-log", false);
  change(".chart-log-y", true);
  seen.types = [one(".chart").layout.xaxis.type, one(".chart").layout.yaxis.type];

  const split = one(".split");
  split.value = 20;
  split.dispatchEvent(new Event("input"));
  seen.split = one(".stage").style.getPropertyValue("--split");
  seen.loaded = one(".img-a").naturalWidth;
  one(".to-pictures").click();
  seen.opened = [one(".viewer-b").value, document.activeElement.className];
  press(one(".stage"), "ArrowRight");
  seen.splitByKey = one(".stage").style.getPropertyValue("--split");
  press(one(".stage"), "+");
  press(one(".stage"), "ArrowRight");
  seen.zoomByKey = one(".stage").style.getPropertyValue("--zoom");
  seen.panByKey = one(".stage").style.getPropertyValue("--pan-x");
  press(one(".stage"), "]");
  seen.nextView = one(".viewer-view").selectedOptions[0].text;
  press(one(".stage"), "[");
  change(".viewer-mode", "difference");
  seen.mode = one(".stage").dataset.mode;
  change(".viewer-zoom", "4");
  seen.zoom = one(".stage").style.getPropertyValue("--zoom");
  seen.layers = Array.from(one(".viewer-layer").options).map((option) => option.value);
  change(".viewer-layer", "flip");
  change(".viewer-b", "3dgs");
  await wait(300);
  seen.flip = [one(".img-b").getAttribute("src"), one(".img-b").naturalWidth];
  change(".viewer-layer", "beta");
  seen.absent = [one(".tag-b").textContent, one(".img-b").hidden];
  change(".viewer-layer", "image");
  seen.chosen = one(".tag-b").textContent;
  seen.pressed = one('.strip [aria-pressed="true"] b').textContent;

  seen.failures = all(".failures tbody tr").map((row) => Array.from(row.cells).map((cell) => cell.textContent));
  seen.jumps = all("nav a").map((link) => link.textContent);
  one(".response img").loading = "eager";
  await wait(500);
  seen.response = one(".response img").naturalWidth > 0;
  seen.curves = all(".curves").map((plot) => plot.data.filter((trace) => trace.showlegend).map((trace) => trace.name));
  seen.quantities = all(".curve-y").map((select) => select.value);

  const heading = all('[data-title="toy/chrome_room"] .sort').find((button) => button.textContent.startsWith("PSNR"));
  const order = () => Array.from(heading.closest("table").tBodies[0].rows).map((row) => row.cells[0].textContent);
  heading.click();
  seen.ascending = order();
  heading.click();
  seen.descending = order();
  const focusable = "a[href], button, select, input, summary, [tabindex='0']";
  const names = (node) => [node.textContent.trim(), node.ariaLabel, node.querySelector("img"), (node.labels || [])[0]];
  seen.unnamed = all(focusable).filter((node) => !names(node).some(Boolean)).map((node) => node.outerHTML);
  seen.address = Object.fromEntries(new URLSearchParams(location.search));
  seen.hacked = window.hacked === 1;
  seen.resources = performance.getEntriesByType("resource").map((entry) => entry.name);
  seen.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  all("details").forEach((part) => (part.open = true));
  seen.scrolled = all(".scroll").map((box) => {
    Object.assign(box.style, { maxHeight: "150px", maxWidth: "250px" });
    box.scrollTo(60, 40);
    const corner = box.querySelector("thead tr:last-child > *").getBoundingClientRect();
    const first = box.querySelector("tbody tr > *").getBoundingClientRect();
    const { left, top } = box.getBoundingClientRect();
    const named = box.querySelector("tbody th") !== null;
    const { scrollLeft, scrollTop } = box;
    return [named, scrollLeft, scrollTop, corner.left - left, first.left - left, corner.top - top].map(Math.round);
  });
}
window.addEventListener("load", async () => {
  await probe(window.seen).catch((error) => window.seen.errors.push(String(error.stack)));
  const output = document.createElement("pre");
  output.id = "seen";
  output.textContent = "SEEN" + encodeURIComponent(JSON.stringify(window.seen)) + "SEEN";
  document.body.append(output);
});
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    folder = tmp_path_factory.mktemp("page")
    write_runs(folder / "runs", seeds=(0, 1), size=(24, 32))
    write_failure(folder / "runs", "toy/chrome_room", "single_set", 0, "diverged", "the loss was not finite")
    write_failure(folder / "runs", "toy/chrome_room", "2dgs", 2, "timeout", "not finished after timeout_minutes=1")
    for steps in (500, 1000):  # a sweep
        for seed in (0, 1):
            slow = record("toy/chrome_room", "slow", seed, steps=steps)
            slow["timing"]["frame_ms"] = 900.0 + seed
            slow["metrics"]["mean"]["psnr"] -= 500 / steps
            write_record(folder / f"runs/slow-{steps}-{seed}", slow)
    for seed, status in ((0, "ok"), (1, "timeout")):
        perturbed: dict[str, Any] = {"perturbation": {"kind": "blur", "severity": 2, "level": HOSTILE}}
        if status != "ok":
            perturbed |= {"status": status, "error": {"type": HOSTILE, "message": HOSTILE, "log_tail": ""}}
        write_record(folder / f"runs/perturbed-{seed}", record("toy/chrome_room", "envgs", seed) | perturbed)
    hostile: dict[str, Any] = {"method": HOSTILE, "overrides": [HOSTILE], "dataset": "toy/chrome_room"}
    write_record(folder / "runs/hostile", record("toy/chrome_room", "other", 0) | hostile)
    error = {"type": HOSTILE, "message": HOSTILE, "log_tail": HOSTILE}
    failed = hostile | {"status": "failed", "error": error, "dataset": HOSTILE}
    write_record(folder / "runs/failed", record("toy/chrome_room", "other", 1) | failed)
    broken = run_folder(folder / "runs", "toy/chrome_room", "<b>broken", 9)
    write_record(broken, record("toy/chrome_room", "other", 2) | {"status": HOSTILE})
    return build_report(folder / "runs", folder / "out", for_print=True)


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
    groups = chapter(report.sections[0]).groups
    ladder = AblationLadders.name  # has a layout of its own: test_ablation_ladder.py
    for table in [table for group in groups if group.kind != ladder for table in group.tables]:
        grouped = any(heading.group for heading in headings(table))
        head, *body = page.tables[table.title][grouped:]
        assert [text.strip().replace("\N{NO-BREAK SPACE}", " ") for text in head] == [h.text for h in headings(table)]
        for row, cells in zip(table.rows, body, strict=True):
            for entry, cell in zip(entries(table, row), cells, strict=True):
                mark = str(entry.rank or "")
                value, sign, spread = entry.text.partition(" ± ") if entry.number else (entry.text, "", "")
                expected = value + mark + (f" ± {spread}" if sign else "") + (" ≈" if entry.tied else "")
                assert " ".join(cell.split()) == " ".join(expected.split())


def test_interrupted_runs_are_not_said_to_have_failed(tmp_path: Path) -> None:
    error = {"type": "KeyboardInterrupt", "message": "interrupted", "log_tail": ""}
    ended = record("toy/room", "envgs", 0) | {"status": "interrupted", "error": error}
    write_record(run_folder(tmp_path / "runs", "toy/room", "envgs", 0), ended)
    report = build_report(tmp_path / "runs", tmp_path / "report")
    assert str(report).startswith("1 run, 1 of them interrupted: ")
    table = (tmp_path / "report" / "table.md").read_text()
    assert "interrupted: interrupted" in table
    assert "KeyboardInterrupt" not in table


def test_a_folder_that_cannot_be_written_names_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_record(run_folder(tmp_path / "runs", "toy/room", "envgs", 0), record("toy/room", "envgs", 0))
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", Path("/proc/none/report")):
        assert main(["report", str(tmp_path / "runs"), "--out", str(out)]) == 1
        shown = capsys.readouterr().err
        assert shown.startswith(f"envgs-bench report: --out {out}: cannot be written (")
        assert "); give another place as --out\n" in shown


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
        f"assets/{name}" for name in ("plotly.min.js", "data.js", *SCRIPTS)
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
        "weights of VGG-16",
    ):
        assert words in html, words
    assert "†" not in html  # no run trained without a loss
    assert "What runs trained without" not in html


def test_the_page_marks_dropped_losses_and_lists_them_by_run(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("2dgs", "envgs"), seeds=(0, 1), pictures=False)
    changes = {"overrides": [], "dropped_losses": {"mono": "no <normals>"}}
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0, 1), pictures=False, **changes)
    write_failure(tmp_path / "runs", "toy/chrome_room", "envgs", 2, "diverged", "lost", **changes)
    html = build_report(tmp_path / "runs", tmp_path / "out").page.read_text()
    page = Page(html)
    assert [row[0] for row in page.tables["toy/chrome_room"][1:]] == ["2dgs", "envgs†"]
    assert {given["data-method"] for _, given in page.tags if "data-method" in given} == {"2dgs", "envgs"}
    assert "† envgs: trained without L_mono: no &lt;normals&gt;." in html
    listed = html.split("What runs trained without</summary>")[1].split("</table>")[0]
    cells = "<td>toy/chrome_room</td><td>envgs</td><td>{}</td><td>L_mono</td><td>no &lt;normals&gt;</td>"
    assert [line for line in listed.splitlines() if "<td>" in line] == [
        *(f"{'<tbody>' * (seed == 0)}<tr>{cells.format(seed)}</tr>" for seed in (0, 1, 2))
    ]


def test_the_charts_are_drawn_from_the_tables_numbers(report: Report) -> None:
    text = (report.out / "assets/data.js").read_text()
    data = json.loads(text.removeprefix("window.REPORT = ").removesuffix(";\n"))
    (section,) = report.sections
    (drawn,) = data["sections"]
    assert [subject["title"] for subject in drawn["subjects"]] == [t.title for t in section.subjects if t.columns]
    for subject in drawn["subjects"]:
        table = next(table for table in section.subjects if table.title == subject["title"])
        for row in subject["rows"]:
            cells = next(r.cells for r in table.rows if r.method == row["method"])
            assert row["values"].keys() == {key for key, cell in cells.items() if cell.shown}
            for key, (mean, low, high, printed) in row["values"].items():
                column, scale = cells[key].column, float(cells[key].column.scale)
                assert printed == cells[key].text
                assert column.unsigned(mean / scale) == printed.split(" ± ")[0]
                if cells[key].interval is not None:
                    assert (low, high) == pytest.approx([end * scale for end in cells[key].interval], rel=1e-6)


def browse(report: Report, folder: Path, width: int) -> dict[str, Any]:
    """What PROBE saw in a window of that width, with no network; fails on any error in the console."""
    shutil.copytree(report.out, folder / "page")
    (folder / "page/assets/probe.js").write_text(PROBE)
    page = folder / "page/index.html"
    page.write_text(page.read_text().replace("<title>", '<script src="assets/probe.js"></script><title>', 1))
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    flags += " --disable-component-update --disable-sync --virtual-time-budget=20000 --dump-dom"
    flags += f" --enable-logging=stderr --window-size={width},1000"
    blocked = "--host-resolver-rules=MAP * ~NOTFOUND"
    command = [str(CHROMIUM), *flags.split(), blocked, f"--user-data-dir={folder / 'profile'}", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    found = re.search(r'<pre id="seen">SEEN(.*?)SEEN', run.stdout)
    assert found, run.stderr[-2000:]
    seen: dict[str, Any] = json.loads(unquote(found.group(1)))
    assert seen["errors"] == []
    assert "CONSOLE" not in run.stderr, run.stderr
    assert not seen["hacked"]
    assert seen["resources"] == []  # what is fetched from anywhere but files
    assert seen["unnamed"] == []
    return seen


NAMES_BESIDE_THE_AXIS = """
addEventListener("load", () => setTimeout(() => {
  const left = (element) => element.getBoundingClientRect().left;
  const names = Array.from(document.querySelectorAll(".chart .textpoint text"), left);
  const axis = left(document.querySelector(".chart .nsewdrag"));
  document.body.append(`FROM${JSON.stringify(names.map((name) => name - axis))}FROM`);
}, 3000));
"""


@needs_chromium
def test_names_in_the_chart_keep_clear_of_the_axis(tmp_path: Path) -> None:
    for method, frame_ms, psnr in (("3dgs_tuned", 27.1, 19.87), ("envgs", 311.9, 20.88)):
        content = record("toy/room", method, 0)
        content["timing"]["frame_ms"], content["metrics"]["mean"]["psnr"] = frame_ms, psnr
        write_record(run_folder(tmp_path / "runs", "toy/room", method, 0), content)
    page = build_report(tmp_path / "runs", tmp_path / "page").page
    (page.parent / "assets/probe.js").write_text(NAMES_BESIDE_THE_AXIS)
    page.write_text(page.read_text().replace("<title>", '<script src="assets/probe.js"></script><title>', 1))
    flags = "--headless --no-sandbox --disable-gpu --virtual-time-budget=20000 --dump-dom --window-size=1280,1000"
    command = [str(CHROMIUM), *flags.split(), f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120).stdout
    distances = json.loads(re.findall(r"FROM(\[[^\]]*\])FROM", shown)[-1])
    assert len(distances) == 2
    assert min(distances) > 3


@needs_chromium
def test_the_page_works_in_a_browser_without_network(report: Report, tmp_path: Path) -> None:
    seen = browse(report, tmp_path, 1300)
    table = next(t for t in report.sections[0].subjects if t.title == "toy/chrome_room")
    places = points(table, FRAME_MS, PSNR)
    assert seen["subject"] == "toy/chrome_room"
    assert seen["front"] == [p.label for p in front(places, FRAME_MS, PSNR)]
    assert sorted(seen["all"]) == sorted(seen["again"]) == sorted(p.label for p in places)
    assert set(seen["all"]) - set(seen["undominated"]) == {"slow [steps=500]", "slow [steps=1000]", HOSTILE}
    assert set(seen["all"]) - set(seen["unfailed"]) == {"2dgs"}
    assert set(seen["all"]) - set(seen["without"]) == {"3dgs"}
    assert seen["none"] == []
    assert seen["focusStays"] == "show 3dgs"
    assert seen["symbols"]["2dgs"].endswith("-open")  # it failed once
    assert not seen["symbols"]["envgs"].endswith("-open")
    assert seen["dotted"] == 1
    assert seen["highlight"] == "envgs"
    assert f"PSNR{row_text(table, 'envgs', 'psnr')}" in seen["about"]
    assert seen["yTitle"].startswith("PSNR, dB, reflective region")
    assert seen["static"] == "charts/psnr_reflective-frame_ms.pdf"
    assert (report.out / seen["static"]).is_file()
    assert seen["types"] == ["linear", "log"]


@needs_chromium
def test_the_pages_pictures_move_together_and_by_keyboard(report: Report, tmp_path: Path) -> None:
    seen = browse(report, tmp_path, 390)
    assert seen["wide"] <= 0  # nothing sticks out of a narrow window
    for named, x, y, corner, first, head in seen["scrolled"]:
        assert corner == first == (0 if named else -x)  # the first column stays where it names its rows
        assert head == 0 or y < 40  # and the head, once the groups above it are out of sight
    assert sum(y == 40 and x > 0 for _, x, y, *_ in seen["scrolled"]) > 5
    assert seen["split"] == "20%"
    assert seen["loaded"] == 32
    assert seen["opened"] == ["envgs", "stage"]
    assert seen["splitByKey"] == "22%"
    assert (seen["zoomByKey"], seen["panByKey"]) == ("2", "-2%")
    assert seen["nextView"] == "view 001"
    assert (seen["mode"], seen["zoom"]) == ("difference", "4")
    assert seen["layers"] == ["image", "flip", "error", "base", "reflection", "beta", "normal"]
    assert (report.out / seen["flip"][0]).is_file()
    assert seen["flip"][1] == 32
    assert seen["absent"] == ["3dgs: β: none", True]
    assert seen["chosen"] == seen["pressed"] == "3dgs"
    assert {"0.chart-y.0": "psnr_reflective", "0.viewer-mode.0": "difference"}.items() <= seen["address"].items()
    assert "0.chart-x.0" not in seen["address"]  # as it is when nothing is chosen
    assert seen["quantities"] == ["psnr", "primitives", "loss"]  # which is never 0 all along
    assert seen["curves"] == [["3dgs", "2dgs", "envmap", "envgs"]] * 3
    table = next(t for t in report.sections[0].subjects if t.title == "toy/chrome_room")
    scored = sorted((row for row in table.rows if row.done), key=lambda row: row.cells["psnr"].mean or 0)
    by_psnr = [row.method for row in scored]
    unscored = [row.method for row in table.rows if not row.done]
    assert seen["ascending"] == by_psnr + unscored
    assert seen["descending"] == by_psnr[::-1] + unscored


def row_text(table: Table, method: str, key: str) -> str:
    return next(row.cells[key].text for row in table.rows if row.method == method)


@needs_chromium
def test_the_page_shows_perturbed_runs_in_a_part_of_their_own(report: Report, tmp_path: Path) -> None:
    seen = browse(report, tmp_path, 1300)
    assert seen["failures"] == [["blur", f"2 {HOSTILE}", "✓◷ 1/2 failed+0.00 dB (one seed)"]]
    assert "Stability" in seen["jumps"]
    assert seen["response"]
