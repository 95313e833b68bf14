"""Text of a record or of a name, made harmless for who shows it."""

from __future__ import annotations

FORMULA = ("=", "+", "-", "@")  # what a spreadsheet takes for the beginning of one


def plain(text: str) -> str:
    """`text` as a terminal may show it: a question mark for each character that it would obey instead of showing it."""
    return "".join(character if character.isprintable() or character in "\n\t" else "?" for character in text)


def plain_line(text: str) -> str:
    """As `plain`, on one line."""
    return plain(" ".join(text.split()))


def no_formula(text: str) -> str:
    """As `plain_line`; behind an apostrophe where a spreadsheet would take it for a formula and compute it."""
    line = plain_line(text)
    return f"'{line}" if line.startswith(FORMULA) else line
