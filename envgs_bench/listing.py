"""What `envgs-bench list` prints: the names that a run can be given."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

from rich.console import Console
from rich.table import Table

CONF = Path(__file__).parent / "conf"


def print_listing() -> int:
    """Print all names, a row each kind of thing; returns the exit status, 0."""
    from .core import available_backends
    from .datasets.registry import BUILT_IN
    from .metrics import PROTOCOLS

    backends = [name if reason is None else f"{name} (not here)" for name, reason in available_backends().items()]
    table = Table("key", "values", show_header=False, box=None)
    table.add_row("method=", ", ".join(sorted({*config_names("method"), *installed_methods()})))
    table.add_row("dataset=", ", ".join(config_names("dataset")))
    table.add_row("dataset.kind=", ", ".join(BUILT_IN))
    table.add_row("protocol=", ", ".join(PROTOCOLS))
    table.add_row("experiment=", ", ".join(config_names("experiment")))
    table.add_row("backends", ", ".join(backends))
    Console(width=120).print(table, highlight=False)
    return 0


def config_names(group: str) -> list[str]:
    """The options of a configuration group, as they are written behind `<group>=`; files named _… are parts of them."""
    root = CONF / group
    files = (path for path in root.rglob("*.yaml") if not path.name.startswith("_"))
    return sorted(path.relative_to(root).with_suffix("").as_posix() for path in files)


def installed_methods() -> list[str]:
    return [point.name for point in entry_points(group="envgs_bench.methods")]
