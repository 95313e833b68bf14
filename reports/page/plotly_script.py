"""plotly's script, which the page draws its charts with, without importing plotly."""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path


def copy_plotly(target: Path) -> None:
    """Copy plotly.min.js to `target`: importing plotly for it takes longer than all else on the page."""
    spec = find_spec("plotly")
    assert spec is not None
    assert spec.origin is not None
    shutil.copyfile(Path(spec.origin).parent / "package_data" / "plotly.min.js", target)
