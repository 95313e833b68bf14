"""The method from scratch that a tutorial shows, and the way to bring another program's pictures: run as they say."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from fakes.runs import CONF, records, set_environment, without_processes

from envgs_bench.cli.main import main
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import check_method, tiny_scene

TESTS = Path(__file__).parent
DOCS = TESTS.parent / "envgs_bench" / "docs"
EXAMPLE = TESTS / "example_method"
QUICK = ("dataset=tiny", "steps=6", "timing.frames=1", "timing.seconds=0.01", "device=cpu")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The example package as an installer leaves it, on the path of this process and of runs; the method's name."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    site = tmp_path / "site"
    info = site / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    heading = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(heading, encoding="utf-8")
    lines = [
        line
        for group, points in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {path}" for name, path in points.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    (site / "blobs.py").write_bytes((EXAMPLE / "blobs.py").read_bytes())
    add_to_path(site, monkeypatch)
    (name,) = project["entry-points"]["envgs_bench.methods"]
    return name


def add_to_path(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")


def run(runs_dir: Path, *overrides: str) -> int:
    return main(["run", "--config-dir", str(CONF), *QUICK, f"runs_dir={runs_dir}", *overrides])


def test_the_example_package_is_listed_runs_and_conforms(
    installed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list"]) == 0
    methods, rest = capsys.readouterr().out.split("dataset=", 1)
    assert "2dgs, 2dgs_lean, 2dgs_mcmc, 2dgs_tuned" in methods
    assert re.search(rf"\b{installed}\b", methods)
    assert not re.search(rf"\b{installed}\b", rest)
    assert run(tmp_path / "runs", f"method={installed}", "method.settings.size=0.05") == 0
    (record,) = records(tmp_path / "runs")
    assert (record.status, record.method, record.steps) == ("ok", installed, 6)
    assert record.config["method"]["settings"]["size"] == 0.05
    assert record.cost is not None
    assert record.cost.primitives == {"base": len(tiny_scene().points), "env": 0}
    check_method(installed)


def test_the_example_learns(installed: str) -> None:
    method, scene = create_method(installed), tiny_scene()
    method.initialize(scene, 100)
    losses = [float(method.training_step(scene.train[step % 5], step)["loss"]) for step in range(1, 101)]
    assert sum(losses[-5:]) < 0.8 * sum(losses[:5])


def test_another_programs_pictures_come_into_the_tables_as_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, _, _ = (DOCS / "how_to" / "other_programs.md").read_text(encoding="utf-8").partition("\n## ")
    export, program, score, ours, report = re.findall(r"^ {4}(\S.*)$", page, re.MULTILINE)
    assert ours == "envgs-bench run method=2dgs_tuned dataset=toy/chrome_room"
    assert report == "envgs-bench report runs --out report"
    monkeypatch.chdir(tmp_path)
    (_, _, *exporting), (_, script, *folders), (_, _, *scoring) = map(shlex.split, (export, program, score))
    assert "dataset=toy/chrome_room" in exporting
    assert main(["export", *exporting, "dataset.kind=fakes.datasets:tiny"]) == 0
    subprocess.run([sys.executable, TESTS.parent / script, *folders], check=True)
    with without_processes():
        assert run(tmp_path / "runs", *scoring, "dataset=tiny") == 0
    (record,) = records(tmp_path / "runs")
    assert (record.status, record.kind, record.method) == ("ok", "renders", "nearest")
    assert record.metrics is not None
    assert len(record.metrics.per_view) == 2
