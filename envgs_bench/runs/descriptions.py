"""What a method is: in a sentence, its configuration's first comment or its class's first words; and its card."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

from envgs_bench.methods.configurations import configured
from envgs_bench.methods.registry import method_class
from envgs_bench.parts import MethodCard

CONFIGURATIONS = Path(__file__).parents[1] / "conf" / "method"


def described(name: str, kind: str) -> str:
    """The sentence on method=<name>, which is of the class that `kind` names; "" where nobody wrote one."""
    file = CONFIGURATIONS / f"{name}.yaml"
    return (_first_comment(file) if file.is_file() else "") or _first_words(kind)


def card_of(name: str, kind: str) -> MethodCard | None:
    """The card of method=<name>, which is of the class that `kind` names; None where that has none.

    One that a class inherits has no label.
    """
    try:
        found = method_class(kind)
    except ValueError:
        return None
    if found.card is None:
        return None
    return configured(name, found.card if "card" in vars(found) else replace(found.card, label=""))


def _first_comment(file: Path) -> str:
    """The sentence that the comment at the file's head begins with."""
    words = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @"):  # which is Hydra's
            words.append(line.removeprefix("#").strip())
    return _first_sentence(" ".join(words))


def _first_words(kind: str) -> str:
    try:
        found = method_class(kind)
    except ValueError:
        return ""
    return _first_sentence(" ".join((inspect.cleandoc(found.__doc__ or "").split("\n\n")[0]).split()))


def _first_sentence(text: str) -> str:
    end = text.find(". ")
    while end >= 0 and text[:end].endswith(("Sec", "App", "al", "Eq")):
        end = text.find(". ", end + 1)
    return text if end < 0 else text[: end + 1]
