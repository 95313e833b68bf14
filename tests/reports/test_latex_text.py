"""LaTeX's text: different names stay different, and nothing is left that pdflatex would stop at."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envgs_bench.reports.tables.latex_text import escaped, label


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2dgs β", r"2dgs $\beta$"),
        ("Ω, ς, λ", r"$\Omega$, $\varsigma$, $\lambda$"),
        ("café Łódź", r"caf\'{e} \L{}\'{o}d\'{z}"),
        ("a_b 100% {x} \\", r"a\_b 100\% \{x\} \textbackslash{}"),
        ("部屋", "{}[U+90E8][U+5C4B]"),
        ("[x]", "{}[x]"),
    ],
)
def test_known_texts(text: str, expected: str) -> None:
    assert escaped(text) == expected


@settings(max_examples=200, deadline=None)
@given(st.text(st.characters(codec="utf-8"), max_size=6), st.text(st.characters(codec="utf-8"), max_size=6))
def test_different_names_stay_different(first: str, second: str) -> None:
    def same(text: str) -> str:
        return unicodedata.normalize("NFC", " ".join(text.split()))

    assert escaped(first).isascii()
    assert (escaped(first) == escaped(second)) == (same(first) == same(second))


def test_labels_hold_nothing_but_letters_digits_and_dashes() -> None:
    assert label("2dgs β, Room_1") == "2dgs-u3b2-room-1"
    assert label("α") != label("β")
