"""The settings of `3dgs_tuned` and `2dgs_tuned`: for tests of the other methods, published growth is slow on a CPU."""

from __future__ import annotations

import yaml

from envgs_bench.cli.composition import CONF

TUNED = yaml.safe_load((CONF / "method" / "_tuned.yaml").read_text(encoding="utf-8"))["settings"]
