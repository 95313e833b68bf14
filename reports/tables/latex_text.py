"""Any text as LaTeX that pdflatex sets, in which different texts stay different."""

from __future__ import annotations

import re
import unicodedata

SYMBOLS = {
    "\\": r"\textbackslash{}",
    "±": r"$\pm$",
    "×": r"$\times$",
    "÷": r"$\div$",
    "·": r"$\cdot$",
    "≈": r"$\approx$",
    "≠": r"$\neq$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "∞": r"$\infty$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "→": r"$\rightarrow$",
    "←": r"$\leftarrow$",
    "−": r"$-$",
    "Δ": r"$\Delta$",
    "°": r"$^\circ$",
    "²": r"$^2$",
    "³": r"$^3$",
    "µ": r"\textmu{}",
    "†": r"$^\dagger$",
    "–": r"\textendash{}",
    "—": "---",
    "…": r"\dots{}",
    "“": r"\textquotedblleft{}",
    "”": r"\textquotedblright{}",
    "‘": r"\textquoteleft{}",
    "’": r"\textquoteright{}",
    "§": r"\S{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{"ß": r"\ss{}", "æ": r"\ae{}", "Æ": r"\AE{}", "œ": r"\oe{}", "Œ": r"\OE{}"},
    **{"ø": r"\o{}", "Ø": r"\O{}", "ł": r"\l{}", "Ł": r"\L{}", "ı": r"\i{}"},
}
ACCENTS = {  # by their combining characters
    **{"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0304": "=", "\u0306": "u", "\u0307": "."},
    **{"\u0308": '"', "\u030a": "r", "\u030b": "H", "\u030c": "v", "\u0323": "d", "\u0327": "c", "\u0331": "b"},
}
GREEK = re.compile(r"GREEK (SMALL|CAPITAL) LETTER (FINAL SIGMA|[A-Z]+)")
GREEK_NAMES = {"FINAL SIGMA": "varsigma", "LAMDA": "lambda"}  # where Unicode spells another than LaTeX
GREEK_LETTERS = (
    *("ALPHA", "BETA", "GAMMA", "DELTA", "EPSILON", "ZETA", "ETA", "THETA", "IOTA", "KAPPA", "LAMDA", "MU", "NU", "XI"),
    *("OMICRON", "PI", "RHO", "SIGMA", "FINAL SIGMA", "TAU", "UPSILON", "PHI", "CHI", "PSI", "OMEGA"),
)
AS_LATIN = {  # Greek letters that LaTeX has no command for, since they look like these
    **{"omicron": "o", "Omicron": "O", "Alpha": "A", "Beta": "B", "Epsilon": "E", "Zeta": "Z", "Eta": "H", "Iota": "I"},
    **{"Kappa": "K", "Mu": "M", "Nu": "N", "Rho": "P", "Tau": "T", "Chi": "X"},
}


def escaped(text: str) -> str:
    """The text on one line: letters with accents and Greek ones as commands; what pdflatex's fonts lack as [U+XXXX]."""
    line = unicodedata.normalize("NFC", " ".join(text.split()))
    hyphens = "{}"  # between two, which would be a dash
    line = "".join(_set(c) + hyphens * (c == after == "-") for c, after in zip(line, line[1:] + " ", strict=False))
    return f"{{}}{line}" if line.startswith(("[", "*")) else line  # which the end of the row above would take


def label(text: str) -> str:
    """The text as a part of a \\label, of small letters, digits and dashes: what is no ASCII by its number."""
    plain = "".join(c if c.isascii() else f"u{ord(c):x}" for c in unicodedata.normalize("NFC", text.lower()))
    return re.sub(r"[^a-z0-9]+", "-", plain).strip("-")


def _set(character: str) -> str:
    if character in SYMBOLS:
        return SYMBOLS[character]
    if character.isascii() and character.isprintable():
        return character
    return _accented(character) or _greek(character) or f"[U+{ord(character):04X}]"


def _accented(character: str) -> str | None:
    """A Latin letter with one accent."""
    base, *marks = list(unicodedata.normalize("NFD", character))
    if len(marks) != 1 or marks[0] not in ACCENTS or not (base.isascii() and base.isalpha()):
        return None
    return f"\\{ACCENTS[marks[0]]}{{{base}}}"


def _greek(character: str) -> str | None:
    found = GREEK.fullmatch(unicodedata.name(character, ""))
    if found is None or found[2] not in GREEK_LETTERS:
        return None
    name = GREEK_NAMES.get(found[2], found[2].lower())
    name = name.capitalize() if found[1] == "CAPITAL" else name
    return rf"$\mathrm{{{AS_LATIN[name]}}}$" if name in AS_LATIN else rf"$\{name}$"
