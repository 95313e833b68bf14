"""Swept settings: which rows differ in one number alone, as in the share of weights that a filter drops."""

from __future__ import annotations

from collections.abc import Mapping

from .settings import as_number


def sweeps(settings: Mapping[str, Mapping[str, str]]) -> list[list[str]]:
    """The lines that one swept setting makes: rows of one code that differ in one numeric setting alone, by its value.

    Args:
        settings: row -> all its settings, its code's name ("kind") among them, as text.
    """
    swept = {key for given in settings.values() for key in given if len({o.get(key) for o in settings.values()}) > 1}
    families: dict[tuple[str, frozenset[tuple[str, str]]], list[tuple[float, str]]] = {}
    for row, given in settings.items():
        for key, value in given.items():
            if key in swept and (number := as_number(value)) is not None:
                others = frozenset(item for item in given.items() if item[0] != key)
                families.setdefault((key, others), []).append((number, row))
    lines = [[row for _, row in sorted(family)] for family in families.values() if len({v for v, _ in family}) > 1]
    return [line for line in lines if len(line) > 2 or len({row.split(" [")[0] for row in line}) == 1]
