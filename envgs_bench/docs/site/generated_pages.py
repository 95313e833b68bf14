"""Parts of pages that are made from the program and from the notebook's entries."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

NOTEBOOK = Path(__file__).parents[1] / "notebook"


def help_of(command: str) -> str:
    """What `envgs-bench <command> --help` prints."""
    from envgs_bench.cli.main import main

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([command, "--help"])
    return printed.getvalue().strip()


def command_line() -> str:
    """A section a command."""
    from envgs_bench.cli.main import COMMANDS

    sections = []
    for name, purpose in COMMANDS.items():
        sentence = f"{purpose[:1].upper()}{purpose[1:]}."
        sections.append(f"## {name}\n\n{sentence}\n\n```text\n{help_of(name)}\n```\n")
    return "\n".join(sections)


def as_value(value: Any) -> str:
    """As it stands behind an override's `=`."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


def settings_table(found: type, keys: tuple[str, ...]) -> str:
    """Rows of name, default and meaning."""
    from envgs_bench.cli.setting_comments import setting_comments

    comments, defaults = setting_comments(found), found()
    rows = (f"| `{key}` | `{as_value(getattr(defaults, key))}` | {cell(comments.get(key, ''))} |" for key in keys)
    return table(["setting", "default", "meaning"], rows)


def table(columns: list[str], rows: Iterable[str]) -> str:
    """A Markdown table."""
    return "\n".join([f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *rows, ""])


def cell(text: str) -> str:
    """Text that stays in one cell."""
    return text.replace("|", "\\|").replace("<", "&lt;")


def settings() -> str:
    """Each built-in method's settings by group, each data source's, and the rules of each recipe."""
    from envgs_bench.datasets.registry import BUILT_IN as SOURCES
    from envgs_bench.methods.registry import BUILT_IN, settings_type
    from envgs_bench.methods.settings import setting_groups

    parts = []
    for name in BUILT_IN:
        found = settings_type(name)
        parts.append(f"## method={name}\n")
        for group, keys in setting_groups(found).items():
            parts.append(f"### {name}: {group}\n\n{settings_table(found, tuple(keys))}")
    parts += [f"## dataset.kind={kind}\n\n{source_table(kind)}" for kind in SOURCES]
    return "\n".join([*parts, "## Rules of the recipes\n", recipes()])


def source_table(kind: str) -> str:
    """Rows of name, default and meaning of a kind of data set."""
    from envgs_bench.cli.setting_comments import setting_comments
    from envgs_bench.datasets.registry import MISSING, SETTINGS, default_settings

    comments = setting_comments(SETTINGS[kind])
    rows = []
    for key, value in default_settings(kind).items():
        default = "has to be given" if value == MISSING else f"`{as_value(value)}`"
        rows.append(f"| `{key}` | {default} | {cell(comments.get(key, ''))} |")
    return table(["setting", "default", "meaning"], rows)


def recipes() -> str:
    """A row a rule, a column a recipe."""
    from envgs_bench.cli.setting_comments import setting_comments
    from envgs_bench.methods.recipes import RECIPES, Rules

    comments = setting_comments(Rules)
    rows = []
    for field in dataclasses.fields(Rules):
        values = (f"`{as_value(getattr(rules, field.name))}`" for rules in RECIPES.values())
        rows.append(f"| `{field.name}` | {' | '.join(values)} | {cell(comments[field.name])} |")
    return table(["rule", *RECIPES, "meaning"], rows)


def comment_of(path: Path) -> str:
    """The comment that a configuration begins with, without its first line where that is Hydra's."""
    lines = [line[1:].strip() for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    text = " ".join(line for line in lines if not line.startswith("@package"))
    return re.sub(r"docs/([\w/]+\.md)", r"[\1](../\1)", text)


def experiments() -> str:
    """A row each experiment, suite and size, from the comments of their files."""
    from envgs_bench.cli.composition import CONF

    parts = []
    for group, title in (("experiment", "Experiments"), ("suite", "Suites of scenes"), ("size", "Sizes")):
        files = sorted((CONF / group).glob("*.yaml"))
        rows = (f"| `{group}={path.stem}` | {cell(comment_of(path))} |" for path in files)
        parts.append(f"## {title}\n\n{table([f'`{group}=`', 'purpose'], rows)}")
    return "\n".join(parts)


def entries() -> str:
    """A row an entry of the notebook, the newest first: its date, its question, what was kept."""
    rows = []
    for path in sorted(NOTEBOOK.glob("2*.md"), reverse=True):
        text = path.read_text(encoding="utf-8")
        question, kept = text.partition("\n")[0].lstrip("# "), text.partition("**Kept:** ")[2].partition("\n")[0]
        rows.append(f"| {path.name[:10]} | [{question}]({path.name}) | {kept} |")
    return table(["date", "question", "kept"], rows)


GENERATED: dict[str, Callable[[], str]] = {
    "reference/command_line": command_line,
    "reference/settings": settings,
    "reference/experiments": experiments,
    "notebook/index": entries,
}
ASIDE = "---\norphan: true\nnosearch: true\n---\n"  # reached by links alone


def complete(app: Sphinx, name: str, source: list[str]) -> None:
    """Add what is generated to a page, and mark the notebook's as outside of navigation and search."""
    if name in GENERATED:
        source[0] = f"{source[0]}\n{GENERATED[name]()}"
    if name.startswith("notebook/"):
        source[0] = ASIDE + source[0]


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", complete)
    return {"parallel_read_safe": True}
