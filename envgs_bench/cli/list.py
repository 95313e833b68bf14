"""`envgs-bench list`: the names that a run can be given, and the settings of a method."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import get_args


def main(arguments: Sequence[str]) -> int:
    """Print all names, a row each kind of thing, or a method's settings; returns the exit status, 0 or 2."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench list",
        usage="envgs-bench list [methods | method NAME | dataset KIND | recipes | programs]",
        description="The names that a run can be given; what each method is; of one method or kind of data set, its "
        "settings, their defaults and what they are; the rules of each recipe; other programs that can be run.",
    )
    parser.add_argument(
        "group", nargs="?", choices=["method", "methods", "dataset", "recipes", "programs"], help=argparse.SUPPRESS
    )
    parser.add_argument("name", nargs="?", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.group is None:
        return _list_names()
    if options.group == "methods":
        return _list_methods() if options.name is None else parser.error("of one method: envgs-bench list method NAME")
    from .settings_lists import print_dataset_settings, print_method_settings, print_programs, print_recipes

    if options.group in ("recipes", "programs"):
        return print_recipes() if options.group == "recipes" else print_programs()
    if options.name is None:
        example = {"method": "envgs", "dataset": "colmap"}[options.group]
        parser.error(f"name a {options.group}, as in: envgs-bench list {options.group} {example}")
    return print_method_settings(options.name) if options.group == "method" else print_dataset_settings(options.name)


def _list_names() -> int:
    from rich.console import Console
    from rich.table import Table

    from envgs_bench.datasets.registry import BUILT_IN
    from envgs_bench.methods.settings import BackendName
    from envgs_bench.parts import LAYOUT_NAMES, PROTOCOL_NAMES
    from envgs_bench.stages.perturbations import OF_SCENES, OF_SETTINGS

    from .composition import config_names

    table = Table("key", "values", show_header=False, box=None)
    table.add_row("method=", ", ".join(config_names("method")))
    table.add_row("dataset=", ", ".join(config_names("dataset")))
    table.add_row("dataset.kind=", ", ".join(BUILT_IN))
    table.add_row("perturb.kind=", ", ".join(["none", *OF_SCENES, *OF_SETTINGS]))
    table.add_row("protocol=", ", ".join(PROTOCOL_NAMES))
    for group in ("experiment", "suite", "size"):
        table.add_row(f"{group}=", ", ".join(config_names(group)))
    table.add_row("method.settings.backend=", ", ".join(get_args(BackendName)))
    table.add_row("layouts of models", ", ".join(LAYOUT_NAMES))
    Console(width=120).print(table, highlight=False)
    return 0


def _list_methods() -> int:
    """Print a sentence a method."""
    from rich.console import Console
    from rich.table import Table

    from envgs_bench.methods.registry import method_paths
    from envgs_bench.runs.descriptions import described

    from .composition import config_names

    table = Table("method", "what it is", box=None, pad_edge=False)
    kinds = method_paths()
    for name in config_names("method"):
        table.add_row(name, described(name, kinds.get(name, name)))
    Console(width=120).print(table, highlight=False, markup=False)
    return 0
