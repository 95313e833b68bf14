"""Settings as methods take them, of settings and rules named side by side."""

from __future__ import annotations

import dataclasses
from typing import Any

from envgs_bench.methods.recipes import Rules

RULES = {field.name for field in dataclasses.fields(Rules)}


def with_rules(**values: Any) -> dict[str, Any]:
    """The same, rules among them below `rules`, where there are any."""
    rules = {key: value for key, value in values.items() if key in RULES}
    own = {key: value for key, value in values.items() if key not in RULES}
    return own | ({"rules": rules} if rules else {})
