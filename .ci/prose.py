"""Words and sentences of the documentation, and a failure where a page is past its bounds.

    python3 .ci/prose.py [--all]

Prose is what is left without code, tables and headings; a sentence ends with a full stop, a question mark or an
exclamation mark, so that a colon or a semicolon makes none shorter. Sentences are bounded on every page but the
notebook's, in cells of tables too; the number of words on pages that are read from start to end. Of reference and
notebook the sums are printed, with --all a row a page.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "envgs_bench" / "docs"
MOST_WORDS = 25_000  # of all pages outside of reference and notebook, tables included
MOST_IN_A_SENTENCE = 24
MOST_NUMBERS = 3  # in one sentence; cells of tables are there for numbers
WORDS = {"how_to": (0, 600), "explanation": (500, 1200), "tutorials": (0, 1500), "README": (0, 350)}  # README: of prose
ONE_TABLE = "explanation"

FENCE = re.compile(r"^```.*?^```$|(?:^ {4,}\S[^\n]*\n?)+|<!--.*?-->", re.MULTILINE | re.DOTALL)
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
RULE = re.compile(r"[|:\s-]+")  # the line below a table's head
END = re.compile(r"(?<=[.?!])[*)\"”]*\s+")  # of a sentence
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
NUMBER = re.compile(r"(?<![\w`×])[+−-]?\d[\d,.]*(?:×\d[\d,.]*)*(?!\w)")


@dataclass(frozen=True)
class Prose:
    """A page's counts."""

    name: str
    words: int  # tables included, code not
    prose: int
    sentences: tuple[str, ...]
    cells: tuple[str, ...]  # sentences in tables
    tables: int

    @property
    def longest(self) -> str:
        return max(self.sentences, key=lambda sentence: len(sentence.split()), default="")

    def row(self) -> str:
        mean = self.prose / max(len(self.sentences), 1)
        return f"{self.name:<58}{self.words:>7}{len(self.sentences):>6}{mean:>7.1f}{len(self.longest.split()):>5}"


def read(path: Path) -> Prose:
    """The counts of a page."""
    text = FENCE.sub("\n", path.read_text(encoding="utf-8"))
    tables = TABLE.findall(text)
    prose = LINK.sub(r"\1", TABLE.sub("\n\n", text))
    sentences = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[*-]|\d+\.) )", prose):
        line = " ".join(block.split()).lstrip("*- ")
        if line and not line.startswith(("#", "---", ":::")):
            sentences += [part for part in END.split(re.sub(r"^\d+\. ", "", line)) if part.strip("*")]
    lines = [line.strip().strip("|") for table in tables for line in table.splitlines() if not RULE.fullmatch(line)]
    cells = [
        part for line in lines for cell in re.split(r"(?<!\\)\|", LINK.sub(r"\1", line)) for part in END.split(cell)
    ]
    name = str(path.relative_to(ROOT).with_suffix("")).removeprefix("envgs_bench/docs/")
    words = len(LINK.sub(r"\1", re.sub(r"[|#*]|:?--+:?", " ", text)).split())
    in_prose = sum(len(each.split()) for each in sentences)
    return Prose(name, words, in_prose, tuple(sentences), tuple(cells), len(tables))


def problems(page: Prose) -> list[str]:
    """What is past its bounds in a page outside the notebook."""
    folder = page.name.partition("/")[0]
    low, high = WORDS.get(folder, (0, sys.maxsize))
    words = page.prose if page.name == "README" else page.words
    found = [] if low <= words <= high else [f"{words} words, expected {low} to {high}"]
    if folder == ONE_TABLE and page.tables > 1:
        found.append(f"{page.tables} tables, expected at most one")
    for sentence in (*page.sentences, *page.cells):
        if len(sentence.split()) > MOST_IN_A_SENTENCE:
            found.append(f"{len(sentence.split())} words: {sentence}")
    for sentence in page.sentences:
        if len(NUMBER.findall(re.sub(r"`[^`]*`", "", sentence))) > MOST_NUMBERS:
            found.append(f"{len(NUMBER.findall(sentence))} numbers: {sentence}")
    return [f"{page.name}: {each}" for each in found]


def total(name: str, pages: list[Prose]) -> str:
    sentences = tuple(sentence for page in pages for sentence in page.sentences)
    return Prose(name, sum(page.words for page in pages), sum(page.prose for page in pages), sentences, (), 0).row()


def main(arguments: list[str]) -> int:
    """Print the counts; 1 where a bound is passed."""
    pages = [read(path) for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))]
    aside = {
        folder: [page for page in pages if page.name.startswith(f"{folder}/")] for folder in ("reference", "notebook")
    }
    kept = [page for page in pages if not any(page in others for others in aside.values())]
    print(f"{'page':<58}{'words':>7}{'sent.':>6}{'mean':>7}{'max':>5}")
    for page in pages if "--all" in arguments else kept:
        print(page.row())
    print(total(f"{len(kept)} pages read from start to end", kept))
    for folder, others in aside.items():
        print(total(f"{len(others)} pages of {folder}", others))
    found = [each for page in pages if page not in aside["notebook"] for each in problems(page)]
    words = sum(page.words for page in kept)
    found += [f"{words} words in all, expected at most {MOST_WORDS}"] if words > MOST_WORDS else []
    print("\n".join(found))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
