"""The settings of `3dgs_tuned` and `2dgs_tuned`: for tests of the other methods, published growth is slow on a CPU."""

from __future__ import annotations

from typing import Any

import yaml

from envgs_bench.cli.composition import CONF


def _settings(name: str) -> dict[str, Any]:
    return yaml.safe_load((CONF / "method" / f"{name}.yaml").read_text(encoding="utf-8"))["settings"]


TUNED_3DGS = _settings("_tuned")
TUNED_2DGS = TUNED_3DGS | _settings("2dgs_tuned")
