"""`envgs-bench store`: the model that a run trained, as files in the layout that is asked for."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Collection, Sequence
from dataclasses import asdict
from pathlib import Path

from envgs_bench.parts import SETS

from .explained import explained

PLACEMENT_NAME = "placement.json"  # beside a model whose world is not its data's: data = shift + scale · model


def main(arguments: Sequence[str]) -> int:
    """Write the files and name them; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench store",
        description="The model that a run trained, as files for viewers and other programs, or as one small file.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="one run's folder, with its checkpoint")
    parser.add_argument("--layout", required=True, metavar="NAME", help="`envgs-bench list` names them")
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="where the files are written")
    options = parser.parse_args(arguments)
    return explained("store", lambda: _store(options.run, options.layout, options.out), options.out)


def _require_no_others(out: Path, sets: Collection[str], moved: bool) -> None:
    """Raise a ValueError where `out` holds what belongs to another model and would stay: a set, or its placement."""
    lacking = {*SETS} - {*sets}
    others = [path.name for path in out.glob("*") if path.name.partition(".")[0] in lacking]
    others += [PLACEMENT_NAME] if not moved and (out / PLACEMENT_NAME).exists() else []
    if others:
        raise ValueError(f"{out}: holds {', '.join(sorted(others))} of another model; give a new folder as --out")


def _store(run: Path, name: str, out: Path) -> int:
    from envgs_bench.stored.layout_losses import open_sets, require_layouts
    from envgs_bench.stored.reopening import placement_of

    (layout,) = require_layouts([name]).values()
    _, method = open_sets(run, "cpu")
    placement = placement_of(run)
    moved = placement is not None and not placement.unmoved
    _require_no_others(out, {*method.model.sets}, moved)
    for path in layout.write(method, out):
        print(path)
    if placement is not None and moved:
        path = out / PLACEMENT_NAME
        path.write_text(json.dumps(asdict(placement)) + "\n", encoding="utf-8")
        print(path)
        print(
            f"envgs-bench store: the model is in the world that the run was trained in, since float32 cannot hold the "
            f"data's own coordinates: a place of the data is {placement}",
            file=sys.stderr,
        )
    if lacking := layout.lacks(method):
        print(f"envgs-bench store: {name} has no place for {', '.join(lacking)}: left out", file=sys.stderr)
    return 0
