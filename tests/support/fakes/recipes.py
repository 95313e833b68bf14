"""Recipes of the fake program."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

PROGRAM = Path(__file__).parents[1] / "fake_program" / "program.py"


def content(mode: str, *flags: str, **others: Any) -> dict[str, Any]:
    """The keys of a recipe whose training behaves as `mode` says."""
    command = f"{sys.executable} {PROGRAM} {mode} {{data}} {{output}} {{steps}} {' '.join(flags)} {{arguments}}"
    return {
        "name": "fake-program",
        "page": "https://example.org/fake",
        "layout": "blender",
        "train": command,
        "pictures": {"files": "{output}/test/*"},
        "seconds": {"pattern": r"trained for ([\d,]+) ms", "unit": 0.001},
        "step": r"step (\d+)/",
        **others,
    }


def recipe_file(folder: Path, mode: str, *flags: str, **others: Any) -> Path:
    """A file with that recipe; JSON is YAML."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{mode}.yaml"
    path.write_text(json.dumps(content(mode, *flags, **others)))
    return path
