"""What `envgs-bench list method NAME` prints: the settings of a method, or what sets a variant apart from its kind."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.errors import CompactHydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.table import Table

from envgs_bench.methods.registry import method_class
from envgs_bench.methods.settings import setting_comments
from envgs_bench.records import RENDERS
from envgs_bench.stages.renders import RendersSettings

from .composition import CONF, explain, register_choices

WRONG_ARGUMENTS = 2


def print_method_settings(name: str) -> int:
    """Print a row each setting of method=<name>: its name, its value, and what it is.

    A variant's rows are those in which it differs from the method that it is a variant of, with both values.

    Returns:
        The exit status: 0, or 2 where there is no such method; standard error then says which there are.
    """
    chosen = f"method={name}"
    register_choices([chosen])
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            method = compose("config", [chosen]).method
        settings_type = RendersSettings if method.kind == RENDERS else method_class(method.kind).Settings
    except (CompactHydraException, OmegaConfBaseException, ValueError) as error:
        print(f"envgs-bench list: {explain(error)}", file=sys.stderr)
        return WRONG_ARGUMENTS
    values: Any = OmegaConf.to_container(method.settings)
    defaults, comments = dataclasses.asdict(settings_type()), setting_comments(settings_type)
    of_its_own = method.name != method.kind.rpartition(":")[2]
    shown = [key for key in defaults if not of_its_own or values.get(key) != defaults[key]]
    table = Table("setting", name, *([method.kind] if of_its_own else []), "", box=None, pad_edge=False)
    for key in shown:
        given = [values.get(key), *([defaults[key]] if of_its_own else [])]
        table.add_row(key, *map(_as_override, given), comments.get(key, ""))
    console = Console(width=140)
    console.print(table, highlight=False, markup=False)
    ending = f"All else is as in {method.kind}: envgs-bench list method {method.kind}"
    console.print(f"\n{ending if of_its_own else 'Change one with method.settings.NAME=VALUE'}", highlight=False)
    return 0


def _as_override(value: Any) -> str:
    """As it would stand behind method.settings.<key>=."""
    return str(value).lower() if isinstance(value, bool) else str(value)
