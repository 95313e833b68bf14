"""Every file, folder, module, link, command and choice that the documentation names is there; its lines of code run."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from envgs_bench.cli.composition import composed, config_names
from envgs_bench.cli.main import COMMANDS
from envgs_bench.metrics import PROTOCOLS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "envgs_bench" / "docs"
NOTEBOOK = sorted((DOCS / "notebook").glob("*.md"))  # entries speak of the names of their day
PAGES = sorted(set(DOCS.rglob("*.md")) - set(NOTEBOOK))
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]
ROOMS = ("methods", "datasets", "metrics", "reports", "tests", "envgs_bench")  # folders of sources
SOURCE = re.compile(r"[\w./*-]+\.(py|cpp|h|cu|cuh)")
ELSEWHERE = {  # not of this project
    *("eval.py", "metrics.py", "render.py", "utils.py"),
    *("my_method.py", "my_format.py", "nearest.py"),
}

CODE = re.compile(r"`([^`\n]+)`")
COMMAND = re.compile(r"^ {4,}.*$|^```.*?^```", re.MULTILINE | re.DOTALL)
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
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
    return [
        *(path for path in sorted(named_paths(text)) if not path_exists(path)),
        *(name for name in MODULE.findall(text) if not module_exists(name)),
        *broken_links(text, document),
    ]


def broken_links(text: str, document: Path) -> list[str]:
    links = [link for link in LINK.findall(CODE.sub("", text)) if "://" not in link]
    return [link for link in links if not link_exists(link, document)]


def name_of(document: Path) -> str:
    return str(document.relative_to(ROOT).with_suffix(""))


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_what_a_document_names_is_there(document: Path) -> None:
    assert problems(document.read_text(encoding="utf-8"), document) == []


def test_links_of_the_notebook_lead_somewhere() -> None:
    broken = {path.name: broken_links(path.read_text(encoding="utf-8"), path) for path in NOTEBOOK}
    assert {name: links for name, links in broken.items() if links} == {}


ENTRY = re.compile(
    r"# .+\?\n\n\* \*\*Date:\*\* (\d{4}-\d\d-\d\d)\n"
    r"\* \*\*Expected:\*\* .+\n\* \*\*Seen:\*\* .+\n\* \*\*Kept:\*\* .+\n"
)


@pytest.mark.parametrize("entry", [path for path in NOTEBOOK if path.stem != "index"], ids=lambda path: path.stem)
def test_an_entry_has_one_question_a_date_and_what_became_of_it(entry: Path) -> None:
    head = ENTRY.match(entry.read_text(encoding="utf-8"))
    assert head is not None
    assert entry.name.startswith(f"{head[1]}-")


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
    assert len(problems(text, DOCS / "reference" / "core.md")) == 1


ASIDE = {"index", "api", "glossary"}


@pytest.mark.parametrize("page", [path for path in PAGES if not ASIDE & {path.stem, path.parent.name}], ids=name_of)
def test_every_page_leads_into_the_glossary(page: Path) -> None:
    links = [link.partition("#")[0] for link in LINK.findall(page.read_text(encoding="utf-8"))]
    assert DOCS / "reference" / "glossary.md" in {(page.parent / link).resolve() for link in links}


def test_the_glossary_is_in_order_and_explains_each_word() -> None:
    text = (DOCS / "reference" / "glossary.md").read_text(encoding="utf-8")
    words = re.findall(r"^## (.*)\n\n\S.*\.$", text, re.MULTILINE)
    assert words == re.findall(r"^## (.*)$", text, re.MULTILINE) == sorted(words, key=str.lower)


CHOICE = re.compile(r"\b(method|dataset|experiment|suite|size|protocol)=([^\s`'\")…]+)")
CALL = re.compile(r"envgs-bench ([a-z]\w*)\b")
EXAMPLES = {"mine", "blobs", "smooth"}  # what readers are shown how to add


def names_that_are_none(text: str) -> list[str]:
    """Commands, methods, data sets, experiments and protocols that the text names and that there are not."""
    found = [f"envgs-bench {name}" for name in CALL.findall(text) if name not in COMMANDS]
    for key, values in CHOICE.findall(text):
        names = values.rstrip(".,;:").split(",")
        known = set(PROTOCOLS) if key == "protocol" else set(config_names(key))
        found += [f"{key}={name}" for name in names if not re.search("[:<*]", name) and name not in known | EXAMPLES]
    return found


@pytest.mark.parametrize(
    "document", [path for path in DOCUMENTS if path.stem != "migration"], ids=name_of
)  # that page names what there was
def test_every_name_that_a_document_gives_a_command_is_one(document: Path) -> None:
    assert names_that_are_none(document.read_text(encoding="utf-8")) == []


def test_every_method_is_on_the_page_of_methods() -> None:
    text = (DOCS / "reference" / "methods.md").read_text(encoding="utf-8")
    assert [name for name in config_names("method") if f"`{name}`" not in text] == []


def test_pages_that_sources_name_are_there() -> None:
    """`docs/…` in comments, help texts and configurations."""
    sources = [path for room in ROOMS for kind in ("*.py", "*.yaml") for path in (ROOT / room).rglob(kind)]
    found = {
        f"{path}: {page}"
        for path in sources
        for page in re.findall(r"\bdocs/([\w/-]+\.md)", path.read_text(encoding="utf-8"))
        if not (DOCS / page).exists()
    }
    assert len(sources) > 500
    assert found == set()


def test_a_name_that_is_none_is_found() -> None:
    text = "envgs-bench rnu -m method=envgs,envgz dataset=toy/glas experiment=demo protocol=strikt"
    assert names_that_are_none(text) == ["envgs-bench rnu", "method=envgz", "dataset=toy/glas", "protocol=strikt"]


def test_every_command_is_in_some_document() -> None:
    text = "\n".join(document.read_text(encoding="utf-8") for document in DOCUMENTS)
    assert set(COMMANDS) <= set(CALL.findall(text)), set(COMMANDS) - set(CALL.findall(text))


def test_the_lines_on_the_core_run() -> None:
    page = (DOCS / "explanation" / "core.md").read_text(encoding="utf-8")
    (block,) = [code for code in PYTHON.findall(page) if "trace(" in code]
    names: dict[str, Any] = {}
    exec(compile(block, "core.md", "exec"), names)
    assert names["image"].color.shape == (240, 320, 3)
    assert float(names["surfels"].sh.grad.abs().sum()) >= 0.0
    assert float((names["image"].alpha - names["rays"].alpha).detach().abs().median()) < 1e-3


def test_a_version_is_cited_that_there_is_and_the_change_list_begins_with_what_is_to_come() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == project["version"]
    assert citation["references"][0]["title"].startswith("EnvGS")
    titles = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert titles[0] == "Unreleased"
    assert project["version"] in titles
    workflow = yaml.safe_load((ROOT / ".github/workflows/checks.yaml").read_text(encoding="utf-8"))
    pythons = workflow["jobs"]["checks"]["strategy"]["matrix"]["python"]
    assert [f"Programming Language :: Python :: {python}" in project["classifiers"] for python in pythons] == [True] * 3


def test_the_command_for_a_new_data_format_is_read() -> None:
    page = (DOCS / "how_to" / "add_data_format.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^PYTHONPATH=\. envgs-bench run (.+)$", page, re.MULTILINE)
    assert composed(command.split()).dataset["root"].endswith("FOLDER")
