"""What `envgs-bench list` prints of a method, a kind of data set and the recipes: settings, and what they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.errors import CompactHydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.table import Table

from envgs_bench.datasets.registry import MISSING, SETTINGS, default_settings
from envgs_bench.methods.recipes import RECIPES, Rules
from envgs_bench.methods.registry import settings_type
from envgs_bench.methods.settings import setting_groups
from envgs_bench.programs.recipe import read_recipe, shipped_recipes
from envgs_bench.records import EXTERNAL, RENDERS
from envgs_bench.stages.render_files import RendersSettings

from .composition import CONF, explain, register_choices
from .explained import complain
from .setting_comments import setting_comments

WRONG_ARGUMENTS = 2
WIDTH, WIDE = 140, 200


def print_method_settings(name: str) -> int:
    """Print a row each setting of method=<name>, in its groups: its name, its value, and what it is.

    A variant's rows are those in which it differs from the method that it is a variant of, with both values.

    Returns:
        The exit status: 0, or 2 where there is no such method; standard error then says which there are.
    """
    chosen = f"method={name}"
    try:
        register_choices([chosen])
        with initialize_config_dir(str(CONF), version_base="1.3"):
            method = compose("config", [chosen]).method
        if method.kind == EXTERNAL:
            return print_programs()
        found = RendersSettings if method.kind == RENDERS else settings_type(method.kind)
    except (CompactHydraException, OmegaConfBaseException, ValueError) as error:
        complain("list", explain(error), see="reference/methods")
        return WRONG_ARGUMENTS
    values: Any = OmegaConf.to_container(method.settings)
    defaults, comments = dataclasses.asdict(found()), setting_comments(found)
    of_its_own = method.name != method.kind.rpartition(":")[2]
    table = Table("setting", name, *([method.kind] if of_its_own else []), "", box=None, pad_edge=False)
    for group, keys in setting_groups(found).items():
        shown = [key for key in keys if not of_its_own or values.get(key) != defaults[key]]
        if shown and not of_its_own:
            table.add_row(f"# {group}")
        for key in shown:
            given = [values.get(key), *([defaults[key]] if of_its_own else [])]
            table.add_row(key, *map(_as_override, given), comments.get(key, ""))
    console = Console(width=WIDTH)
    console.print(table, highlight=False, markup=False)
    ending = f"All else is as in {method.kind}: envgs-bench list method {method.kind}"
    console.print(f"\n{ending if of_its_own else 'Change one with method.settings.NAME=VALUE'}", highlight=False)
    return 0


def print_dataset_settings(kind: str) -> int:
    """Print a row each setting of dataset=<kind>; returns the exit status, 0, or 2 where there is no such kind."""
    if kind not in SETTINGS:
        complain("list", f"there is no kind {kind!r} of data set, but {', '.join(SETTINGS)}", see="reference/data_sets")
        return WRONG_ARGUMENTS
    comments = setting_comments(SETTINGS[kind])
    table = Table("setting", kind, "", box=None, pad_edge=False)
    for key, value in default_settings(kind).items():
        table.add_row(key, "has to be given" if value == MISSING else _as_override(value), comments.get(key, ""))
    console = Console(width=WIDTH)
    console.print(table, highlight=False, markup=False)
    console.print("\nChange one with dataset.NAME=VALUE", highlight=False)
    return 0


def print_recipes() -> int:
    """Print a row each rule: what it is in each recipe, and what that means; returns the exit status, 0."""
    table = Table("rule", *RECIPES, "", box=None, pad_edge=False)
    comments = setting_comments(Rules)
    for field in dataclasses.fields(Rules):
        values = [_as_override(getattr(rules, field.name)) for rules in RECIPES.values()]
        table.add_row(field.name, *values, comments[field.name])
    console = Console(width=WIDE)
    console.print(table, highlight=False, markup=False)
    console.print("\nChoose one with method.settings.recipe=NAME, change a rule with method.settings.rules.RULE=VALUE")
    return 0


def print_programs() -> int:
    """Print a row each recipe that ships: the program's page, the commit, and what it was tried on; returns 0."""
    table = Table("method.recipe=", "its page", "for", "licence", "tried on", box=None, pad_edge=False)
    for name in shipped_recipes():
        recipe = read_recipe(name)
        table.add_row(name, recipe.page, recipe.commit, recipe.licence, recipe.tried or "untried")
    console = Console(width=WIDE)
    console.print(table, highlight=False, markup=False)
    console.print("\nRun one with method=external method.recipe=NAME, a recipe of yours with method.recipe=FILE")
    return 0


def _as_override(value: Any) -> str:
    """As it would stand behind method.settings.<key>=."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{_as_override(each)}" for key, each in value.items()) + "}"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return "[" + ",".join(map(_as_override, value)) + "]"
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)
