"""What methods/ may not outgrow again: depth, width, what a step passes, and which room imports which."""

from __future__ import annotations

import ast
import sys
from abc import ABC
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from envgs_bench import methods
from envgs_bench.methods.envgs import EnvGS, EnvGSSettings
from envgs_bench.methods.registry import BUILT_IN, method_class
from envgs_bench.testing import tiny_scene

HOUSE = Path(methods.__file__ or "").parent
DEPTH, MEMBERS, FILES_OF_A_STEP, LINES = 3, 40, 10, 330
DOOR = {
    "__init__",
    "method",
    "registry",
    "settings",
    "recipes",
    "validation",
    "configurations",
    "gaussian_method",
}  # flat beside a file a method
# Each imports those before it, and the contracts, which import no room.
CONTRACTS = {"method", "settings", "recipes", "validation"}
ROOMS = ("training", "gaussians", "lighting", "storage")


def modules() -> Iterator[tuple[Path, str]]:
    """Each file, with the room that it is in: "" for the door."""
    for path in sorted(HOUSE.rglob("*.py")):
        within = path.relative_to(HOUSE).parts
        yield path, within[0] if len(within) > 1 else ""


def imported(path: Path) -> Iterator[str]:
    """What the file names of methods/ in relative imports, as paths from there: training.schedule."""
    package = path.relative_to(HOUSE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from (".".join([*base, name]) for name in names)


def test_envgs_is_few_classes_deep_and_few_members_wide() -> None:
    """Members: all names of its classes but `object`'s and `ABC`'s, private ones too, and those of an instance."""
    classes = [each for each in EnvGS.__mro__ if each not in (object, ABC)]
    names = {name for each in classes for name in vars(each)} | set(vars(EnvGS(EnvGSSettings())))
    own = {name for name in names if not (name.startswith("__") and name.endswith("__")) and name != "_abc_impl"}
    assert len(classes) <= DEPTH, classes
    assert len(own) <= MEMBERS, sorted(own)


@pytest.mark.parametrize("kind", BUILT_IN)
def test_no_method_is_deeper(kind: str) -> None:
    classes = [each.__name__ for each in method_class(kind).__mro__ if each not in (object, ABC)]
    assert len(classes) <= DEPTH, classes


def test_a_step_of_envgs_passes_few_files() -> None:
    """Files of methods/ of which code runs in a step with reflections, on a CPU, of a view seen before."""
    method, scene, passed = EnvGS(EnvGSSettings(env_grid=2, backend="cpu")), tiny_scene(), set()
    method.initialize(scene, 30_000)
    method.training_step(scene.train[0], 3_001)  # makes the environment

    def trace(frame: FrameType, event: str, argument: Any) -> None:
        path = Path(frame.f_code.co_filename)
        if HOUSE in path.parents:
            passed.add(str(path.relative_to(HOUSE)))

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        method.training_step(scene.train[0], 3_002)
    finally:
        sys.settrace(before)
    assert method.primitives()["env"] > 0
    assert len(passed) <= FILES_OF_A_STEP, sorted(passed)


def test_the_door_has_the_contracts_and_a_file_a_method() -> None:
    of_methods = {path.partition(":")[0].rpartition(".")[2] for path in BUILT_IN.values()}
    assert {path.stem for path, room in modules() if not room} == DOOR | of_methods
    assert {room for _, room in modules() if room} == set(ROOMS)


def test_rooms_import_those_before_them_only() -> None:
    wrong = []
    for path, room in modules():
        allowed = {*CONTRACTS, *ROOMS[: ROOMS.index(room) + 1]} if room else set()
        for name in imported(path) if room else ():
            if name.partition(".")[0] not in allowed:
                wrong.append(f"{path.relative_to(HOUSE)} imports {name}")
    assert not wrong


@pytest.mark.parametrize("contract", sorted(CONTRACTS))
def test_contracts_import_no_room(contract: str) -> None:
    assert not [name for name in imported(HOUSE / f"{contract}.py") if name.partition(".")[0] in ROOMS]


def test_no_module_imports_itself_around_a_corner() -> None:
    files = {".".join(path.relative_to(HOUSE).with_suffix("").parts): path for path, _ in modules()}
    graph = {name: {each for each in imported(path) if each in files} for name, path in files.items()}
    done: set[str] = set()

    def walk(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " → ".join([*above, name])
        if name not in done:
            for each in sorted(graph[name]):
                walk(each, (*above, name))
            done.add(name)

    for name in graph:
        walk(name, ())


def test_no_module_is_long() -> None:
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path, _ in modules()}
    assert not {name: length for name, length in lengths.items() if length >= LINES}
