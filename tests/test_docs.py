"""Every file, folder, module and link that the documentation names is there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "envgs_bench" / "docs").glob("*.md"))]
ROOMS = ("methods", "datasets", "metrics", "reports", "tests", "envgs_bench")  # folders of sources
SOURCE = re.compile(r"[\w./*-]+\.(py|cpp|h|cu|cuh)")
ELSEWHERE = {"metrics.py", "render.py", "utils.py"}  # another program's, and what is said not to be

CODE = re.compile(r"`([^`\n]+)`")
COMMAND = re.compile(r"^ {4,}.*$|^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"[\w.*-]+(?:/[\w.*-]*)+")
MODULE = re.compile(r"\benvgs_bench(?:\.\w+)+")


def named_paths(text: str) -> set[str]:
    """Sources in code, and whatever lies in a room in code and in commands."""
    codes = CODE.findall(text)
    sources = {code for code in codes if SOURCE.fullmatch(code)}
    lines = (*codes, *COMMAND.findall(text))
    return sources | {path for line in lines for path in PATH.findall(line) if path.split("/")[0] in ROOMS}


def path_exists(path: str) -> bool:
    """At the root, in the package, or, for a bare name, anywhere."""
    if path in ELSEWHERE or path.rstrip("/") in ROOMS:
        return True
    path = path.rstrip("/.")
    pattern = path if "/" in path else f"**/{path}"  # a bare file's name
    tops = [ROOT / room for room in ROOMS] if pattern.startswith("**") else [ROOT, ROOT / "envgs_bench"]
    return any(next(top.glob(pattern), None) is not None for top in tops)


def module_exists(name: str) -> bool:
    """A module, or what a module holds."""
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        owner, _, attribute = name.rpartition(".")
        return bool(owner) and module_exists(owner) and hasattr(importlib.import_module(owner), attribute)
    return True


def link_exists(link: str, document: Path) -> bool:
    """The file, and the heading in it."""
    target, _, anchor = link.partition("#")
    path = document.parent / target if target else document
    if not path.exists():
        return False
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE) if anchor else []
    return not anchor or anchor in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings}


def problems(text: str, document: Path) -> list[str]:
    links = [link for link in LINK.findall(CODE.sub("", text)) if "://" not in link]
    return [
        *(path for path in sorted(named_paths(text)) if not path_exists(path)),
        *(name for name in MODULE.findall(text) if not module_exists(name)),
        *(link for link in links if not link_exists(link, document)),
    ]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.stem)
def test_what_a_document_names_is_there(document: Path) -> None:
    assert problems(document.read_text(encoding="utf-8"), document) == []


@pytest.mark.parametrize(
    "text",
    [
        "`methods/nowhere.py` holds it",
        "see `nowhere.py`",
        "`stages/nowhere.py`",
        "`core/kernels/nowhere*.h`",
        "lies in `datasets/nowhere/`",
        "    python -m pytest tests/test_nowhere.py -k x",
        "    python -m envgs_bench.nowhere",
        "```python\nfrom envgs_bench.methods.nowhere import TwoDGS\n```",
        "`envgs_bench.methods.two_d_gs.Nowhere`",
        "[there](nowhere.md)",
        "[there](architecture.md#nowhere)",
    ],
)
def test_what_is_not_there_is_found(text: str) -> None:
    assert len(problems(text, ROOT / "envgs_bench" / "docs" / "core.md")) == 1
