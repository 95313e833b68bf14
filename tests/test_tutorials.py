"""The tutorials are carried out: their files are written, their commands run on small scenes, and what these print has
to be what the page shows, but for numbers."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from glob import glob
from pathlib import Path

import pytest
from corner_photographs import photograph
from fakes.runs import set_environment, without_processes
from PIL import Image

from envgs_bench.cli.main import main
from envgs_bench.testing import check_method

TUTORIALS = Path(__file__).parents[1] / "envgs_bench" / "docs" / "tutorials"
CONSOLE = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)
SOURCE = re.compile(r"^```(?:python|yaml)\n# (\w+\.(?:py|yaml))\n(.*?)^```", re.MULTILINE | re.DOTALL)
STAND_INS = Path(__file__).parent / "support" / "stand_ins"
SHORT = ["steps=6", "timing.frames=1", "timing.seconds=0.01", "device=cpu"]
TINY = [*SHORT, "dataset.width=32", "dataset.height=24", "dataset.supersampling=1"]
PHOTOS = [*SHORT, "dataset.feature_size=240", "dataset.camera_model=SIMPLE_PINHOLE"]
MORE = {  # what makes a command of the page quick, by how it begins
    "envgs-bench run*dataset=toy/*": TINY,
    "envgs-bench run*dataset=photos*": PHOTOS,
    "envgs-bench run*steps=7000": ["steps=7"],
    "envgs-bench masks*": ["--beta", "0.02"],  # so short a training has made nothing reflect
}
NUMBER = re.compile(r"\b(?=\w*\d)[0-9a-f]{8}\b|\d[\d,]*(?:\.\d+)?|—")
RULES = re.compile(r"[━─╇┳┻┴┼]+")


def commands(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Each command of the page's consoles, and the lines shown below it."""
    for block in CONSOLE.findall(page.read_text(encoding="utf-8")):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *shown = part.rstrip("\n").split("\n")
            yield command, shown


def plain(line: str) -> str:
    """The line without what varies by machine: numbers, run ids, and how wide a column is."""
    return " ".join(NUMBER.sub("0", RULES.sub("━", line)).split())


def agrees(shown: list[str], printed: list[str]) -> bool:
    """Whether the printed lines are the shown ones; `...` stands for any number of lines."""
    if not shown:
        return not printed
    if shown[0] == "...":
        return any(agrees(shown[1:], printed[start:]) for start in range(len(printed) + 1))
    return bool(printed) and plain(shown[0]) == plain(printed[0]) and agrees(shown[1:], printed[1:])


def carry_out(command: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What the command prints, run in this process with what makes it quick."""
    words = shlex.split(command.removeprefix("PYTHONPATH=. "))
    words = [found for word in words for found in (glob(word) or [word])]
    if words[0] == "ls":
        return sorted({"log.txt", *(path.name for path in Path(words[1]).iterdir())})  # which a process leaves
    if words[:2] == ["python", "-c"]:
        exec(words[2], {"check_method": check_method})
        return []
    assert words[0] == "envgs-bench"
    for pattern, more in MORE.items():
        words += more if fnmatch(command.removeprefix("PYTHONPATH=. "), pattern) else []
    capsys.readouterr()
    with without_processes():
        status = main(words[1:])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    return printed.out.replace(f"{Path.cwd()}/", "").splitlines()


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of a reader's own."""
    set_environment(monkeypatch)
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("my_method", None)


def take_photographs(folder: Path) -> None:
    folder.mkdir()
    for index in range(8):
        Image.fromarray(photograph(index)).save(folder / f"{index}.png")


def install_programs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand-ins where the page has the reader install OpenSplat and gsplat."""
    bin_, examples = folder / "bin", folder / "gsplat" / "examples"
    for path in (bin_, examples):
        path.mkdir(parents=True)
    for name, words in (("opensplat", f"{sys.executable} {STAND_INS / 'opensplat.py'}"), ("python", sys.executable)):
        (bin_ / name).write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        (bin_ / name).chmod(0o755)
    for name in ("opensplat.py", "simple_trainer.py"):
        shutil.copy(STAND_INS / name, examples)
    monkeypatch.setenv("PATH", str(bin_), prepend=os.pathsep)


@pytest.mark.parametrize("page", sorted(TUTORIALS.glob("*.md")), ids=lambda path: path.stem)
def test_a_tutorials_commands_print_what_it_shows(
    page: Path, reader: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = page.read_text(encoding="utf-8")
    if "method.recipe=opensplat" in text:
        install_programs(reader, monkeypatch)
    if "dataset.root=photos" in text:
        take_photographs(reader / "photos")
    for name, code in SOURCE.findall(text):
        (reader / name).write_text(code, encoding="utf-8")
    ran = 0
    for command, shown in commands(page):
        printed = carry_out(command, capsys)
        assert agrees(shown, printed), (command, printed)
        ran += 1
    assert ran


@pytest.mark.parametrize(
    ("shown", "printed", "agree"),
    [
        (["a 1.5", "..."], ["a 2", "b", "c"], True),
        (["...", "b"], ["a", "b"], True),
        (["a 1"], ["a 1", "b"], False),
        (["ok │ 8d25c9e4 │"], ["ok │   0a7714de │"], True),
        (["ok"], ["failed"], False),
    ],
)
def test_what_is_shown_is_held_against_what_is_printed(shown: list[str], printed: list[str], agree: bool) -> None:
    assert agrees(shown, printed) == agree
