"""Reports' house: a study lives in one folder, one module compares methods, and none is known by name."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import envgs_bench
from envgs_bench import reports
from envgs_bench.methods.configurations import CONFIGURED
from envgs_bench.methods.registry import BUILT_IN
from envgs_bench.reports.studies import STUDIES
from envgs_bench.reports.studies.study import folder_of

PACKAGE = Path(envgs_bench.__file__).parent
REPORTS = Path(reports.__file__ or "").parent
SHARED = [path for path in REPORTS.rglob("*") if path.suffix in (".py", ".j2", ".css", ".js") and path.is_file()]
SHARED = [path for path in SHARED if "studies" not in path.parts]
METHODS = {*BUILT_IN, *CONFIGURED, *(path.stem for path in PACKAGE.glob("conf/method/[!_]*.yaml"))} - {"renders"}
# What names methods because it is about these: what is benchmarked, and beside which program's recipes.
ABOUT_METHODS = {"bench", "conf", "docs"}
PAPERS = {"reports/numbers/published.py"}  # "envgs" is also the name of the paper's protocol and of its captures


def test_a_study_is_one_folder_and_the_registry_lists_it() -> None:
    folders = {path.parent for path in REPORTS.glob("studies/*/study.py")}
    assert {folder_of(study) for study in STUDIES} == folders
    assert len(folders) == len(STUDIES)
    assert len({study.name for study in STUDIES}) == len(STUDIES)


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.name)
def test_what_is_shared_names_no_study(study: type) -> None:
    """Neither its class nor its modules; in prose a word may mean something else."""
    modules = {f"studies.{folder_of(study).name}", study.__name__}
    for path in SHARED:
        text = path.read_text(encoding="utf-8")
        assert not [name for name in modules if name in text], path
        assert f'"{study.name}"' not in text, path


def strings(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def named_methods() -> dict[str, list[str]]:
    """File -> the methods that it names in strings of its own, outside methods/ and what is about these."""
    files = [path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).parts[0] not in ABOUT_METHODS]
    files = [
        path
        for path in files
        if not {"methods", "datasets", "metrics", "reports"} & {path.relative_to(PACKAGE).parts[0]}
    ]
    found = {}
    for path in (*files, *REPORTS.rglob("*.py")):
        place = (
            f"reports/{path.relative_to(REPORTS)}" if path.is_relative_to(REPORTS) else str(path.relative_to(PACKAGE))
        )
        names = sorted(set(strings(path)) & METHODS)
        if names and place not in PAPERS:
            found[place] = names
    return found


def test_no_list_of_methods_is_kept_outside_methods() -> None:
    """One name alone is a default (`bench train` without `method=`); a list has two."""
    assert {place: names for place, names in named_methods().items() if len(names) > 1} == {}
    assert all(not place.startswith("reports/") for place in named_methods())


STATISTICS = {
    "bootstrap",
    "ttest_1samp",
    "ttest_ind",
    "ttest_rel",
    "wilcoxon",
    "mannwhitneyu",
    "stdtrit",
    "permutation_test",
}


def test_one_module_makes_intervals_of_means_and_one_compares_by_them() -> None:
    used: dict[str, set[str]] = {}
    for path in REPORTS.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
        for name in names & STATISTICS:
            used.setdefault(name, set()).add(path.relative_to(REPORTS).as_posix())
    assert used == {"stdtrit": {"numbers/intervals.py"}}


def test_studies_and_tables_compare_by_the_comparison() -> None:
    """Where an interval's end is held against 0 or a tolerance, that is the comparison; elsewhere ends are printed."""
    ends = re.compile(r"\.(low|high)\s*(<|>|<=|>=)|(<|>|<=|>=)\s*-?[\w.]*\.(low|high)\b")
    places = {
        path.relative_to(REPORTS).as_posix()
        for path in REPORTS.rglob("*.py")
        if ends.search(path.read_text(encoding="utf-8"))
    }
    assert places == {"numbers/comparison.py", "studies/stability/expectations.py"}  # the latter of a share of failures
