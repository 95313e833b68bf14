"""Plain: a record's text where it could be more than text, in a terminal, a spreadsheet or another file of lines."""

from __future__ import annotations

FORMULA = ("=", "+", "-", "@")  # what a spreadsheet takes for the beginning of one


def plain_line(text: str) -> str:
    """The text on one line, a question mark for each character that terminals obey instead of showing it."""
    return "".join(character if character.isprintable() else "?" for character in " ".join(text.split()))


def no_formula(text: str) -> str:
    """As `plain_line`; behind an apostrophe where a spreadsheet would compute it."""
    line = plain_line(text)
    return f"'{line}" if line.startswith(FORMULA) else line
