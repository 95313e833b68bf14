"""Text of a record or of a name, made harmless for who shows it."""

from __future__ import annotations


def plain(text: str) -> str:
    """`text` as a terminal may show it: control characters, which would move its cursor, as replacement signs."""
    return "".join(character if character.isprintable() or character in "\n\t" else "�" for character in text)


def no_formula(text: str) -> str:
    """`text` as a spreadsheet shows it: with an apostrophe before what it would take for a formula and compute."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
