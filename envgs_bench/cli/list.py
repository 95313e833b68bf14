"""`envgs-bench list`: the names that a run can be given."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.metadata import entry_points


def main(arguments: Sequence[str]) -> int:
    """Print all names, a row each kind of thing; returns the exit status, 0."""
    parser = argparse.ArgumentParser(prog="envgs-bench list", description="The names that a run can be given.")
    parser.parse_args(arguments)
    from rich.console import Console
    from rich.table import Table

    from envgs_bench.core import available_backends
    from envgs_bench.datasets.registry import BUILT_IN
    from envgs_bench.methods.registry import ENTRY_POINT_GROUP
    from envgs_bench.metrics import PROTOCOLS

    from .composition import config_names

    backends = [name if reason is None else f"{name} (not here)" for name, reason in available_backends().items()]
    installed = [point.name for point in entry_points(group=ENTRY_POINT_GROUP)]
    table = Table("key", "values", show_header=False, box=None)
    table.add_row("method=", ", ".join(sorted({*config_names("method"), *installed})))
    table.add_row("dataset=", ", ".join(config_names("dataset")))
    table.add_row("dataset.kind=", ", ".join(BUILT_IN))
    table.add_row("protocol=", ", ".join(PROTOCOLS))
    table.add_row("experiment=", ", ".join(config_names("experiment")))
    table.add_row("backends", ", ".join(backends))
    Console(width=120).print(table, highlight=False)
    return 0
