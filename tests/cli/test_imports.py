"""What is not imported by commands that need not wait for it; a process each, since this one has imported it all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from envgs_bench.datasets.registry import BUILT_IN as SOURCES
from envgs_bench.datasets.registry import SETTINGS
from envgs_bench.methods.registry import BUILT_IN as METHODS
from envgs_bench.methods.registry import method_class, settings_type
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.metrics import PROTOCOLS
from envgs_bench.parts import LAYOUT_NAMES, PROTOCOL_NAMES

SLOW = {"torch", "hydra", "matplotlib", "pandas", "scipy", "kornia"}
CALL = """
import contextlib, io, sys
from envgs_bench.cli.main import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main({arguments})
print(*sys.modules)
"""
TRAIN = """
import sys
import envgs_bench.runs.worker
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene
scene = tiny_scene()
method = create_method("2dgs")
method.initialize(scene, 2)
method.training_step(scene.train[0], 1)
print(*sys.modules)
"""


def imported(code: str) -> set[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["report", "--help"]], ids=" ".join)
def test_help_waits_for_no_large_library(arguments: list[str]) -> None:
    assert not imported(CALL.format(arguments=arguments)) & SLOW


@pytest.mark.parametrize(
    "arguments", [["list"], ["run", "--cfg", "job", "method=envgs", "dataset=colmap"]], ids=" ".join
)
def test_runs_are_listed_and_composed_without_torch(arguments: list[str]) -> None:
    assert not imported(CALL.format(arguments=arguments)) & (SLOW | {"pycolmap"}) - {"hydra"}


@pytest.mark.parametrize("dry", [["--dry-run"], []], ids=["dry", "run"])
def test_a_command_has_its_runs_made_without_torch(dry: list[str], tmp_path: Path) -> None:
    """Each run has a process of its own, which computes: what asks for it waits for no library that computes."""
    toy = ["dataset=toy/chrome_room", "dataset.views=4", "dataset.supersampling=1"]
    settings = [*toy, "method=2dgs", "size=tiny", "steps=2", "device=cpu"]
    arguments = ["run", *settings, f"runs_dir={tmp_path}", f"cache_dir={tmp_path / 'cache'}", *dry]
    assert not imported(CALL.format(arguments=arguments)) & (SLOW | {"pycolmap"}) - {"hydra"}
    assert len(list(tmp_path.rglob("record.json"))) == (not dry)


@pytest.mark.parametrize("kind", SOURCES)
def test_a_sources_files_are_found_without_torch(kind: str) -> None:
    code = f"import sys; from envgs_bench.datasets.registry import source_of; source_of({kind!r}); print(*sys.modules)"
    assert not imported(code) & SLOW


def test_what_is_listed_without_torch_is_what_there_is() -> None:
    assert {kind: settings_type(kind) for kind in METHODS} == {kind: method_class(kind).Settings for kind in METHODS}
    assert (tuple(PROTOCOLS), tuple(LAYOUTS)) == (PROTOCOL_NAMES, LAYOUT_NAMES)
    assert list(SETTINGS) == list(SOURCES)


def test_training_steps_wait_neither_for_a_compiler_nor_for_charts() -> None:
    assert not imported(TRAIN) & {"torch._dynamo", "torch._inductor", "matplotlib", "pandas", "hydra", "pycolmap"}
