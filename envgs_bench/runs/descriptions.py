"""What a method is, in a sentence: of a configuration its file's first comment, else its class's first words."""

from __future__ import annotations

import inspect
from pathlib import Path

from envgs_bench.methods.registry import method_class

CONFIGURATIONS = Path(__file__).parents[1] / "conf" / "method"


def described(name: str, kind: str) -> str:
    """The sentence on method=<name>, which is of the class that `kind` names; "" where nobody wrote one."""
    file = CONFIGURATIONS / f"{name}.yaml"
    return (_first_comment(file) if file.is_file() else "") or _first_words(kind)


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
