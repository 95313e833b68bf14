"""A run's settings as text, which is how runs are told apart and how a swept setting is found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from envgs_bench.records import Record

LIMITS = ("primitives", "mb", "frame_ms")  # of a budget
NO_LIMIT = "any"


def flat_settings(settings: Any, prefix: str = "") -> dict[str, str]:
    """Nested settings with dotted keys and their values as text; locations and addresses are not settings."""
    if not isinstance(settings, Mapping):
        return {}
    flat: dict[str, str] = {}
    for key, value in settings.items():
        if key in ("root", "path", "cache_dir", "name", "obtain", "download", "photographs"):
            continue
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat |= flat_settings(value, f"{name}.")
        else:
            flat[name] = str(value)
    return flat


def method_settings(record: Record) -> dict[str, str]:
    """All that a run's method was set up with, as text: its own settings, and the budget's limits."""
    budget = record.config.get("budget")
    limits = budget if isinstance(budget, Mapping) else {}
    given = {f"budget.{key}": str(limits[key]) if limits.get(key) is not None else NO_LIMIT for key in LIMITS}
    return flat_settings(record.config.get("method")) | given


def as_number(text: str) -> float | None:
    """The number that a setting's text is; None where it is none."""
    try:
        return float(text)
    except ValueError:
        return None
