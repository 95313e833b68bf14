"""Source fingerprint: a hash of what a source file says, without what only people read. A comment re-runs nothing."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from envgs_bench.datasets.store.contents import remember, remembered

FINGERPRINT = re.compile("[0-9a-f]{64}")
SOURCES = {".py", ".h", ".cpp", ".cu", ".cuh"}
# A string or a character, which is kept; or comments and white space.
C_TOKENS = re.compile(
    r'("(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\')|(?:[ \t\r\n]+|//[^\n]*|/\*.*?\*/)+',
    re.DOTALL,
)
C_RAW_STRING = re.compile(r'\bR"')


def source_fingerprints(paths: Sequence[Path], memory: Path) -> list[bytes]:
    """`source_fingerprint` of each file, from `memory` where its content is known there: parsing all takes a second."""
    known, found = remembered(memory), {}
    own = Path(__file__).read_bytes()  # another way to take fingerprints makes others
    for path in paths:
        content = hashlib.sha256(own + path.read_bytes()).hexdigest()
        before, fingerprint = known.get(str(path), [None, None])
        if before != content or not FINGERPRINT.fullmatch(str(fingerprint)):
            fingerprint = source_fingerprint(path).hex()
        found[str(path)] = [content, fingerprint]
    if found != known:
        remember(memory, found)
    return [bytes.fromhex(fingerprint) for _, fingerprint in found.values()]


def source_fingerprint(path: Path) -> bytes:
    """A hash of the code in a source file, of Python or of C++ and CUDA: equal where the code does the same.

    Of Python that is the syntax tree without docstrings, of C++ the text without comments and with one space for any
    white space. What cannot be parsed is taken as it is.
    """
    content = path.read_bytes()
    try:
        text = content.decode()
        content = (_without_docstrings(text) if path.suffix == ".py" else _without_comments(text)).encode()
    except (UnicodeDecodeError, SyntaxError, ValueError, RecursionError):
        pass
    return hashlib.sha256(content).digest()


def _without_docstrings(text: str) -> str:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                node.body = node.body[isinstance(first.value.value, str) :]
    return _tree_text(tree)


def _tree_text(node: object) -> str:
    """The tree in words that no version of Python changes: fields that are empty, as new ones are, are left out."""
    if isinstance(node, list):
        return f"[{','.join(map(_tree_text, node))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = (f"{name}={_tree_text(value)}" for name, value in ast.iter_fields(node) if value not in (None, []))
    return f"{type(node).__name__}({','.join(fields)})"


def _without_comments(text: str) -> str:
    if C_RAW_STRING.search(text):
        return text  # whose quotes and slashes mean other things
    lines = text.replace("\\\n", " ").splitlines()
    # A directive ends with its line, all else where its tokens end.
    marked = "\n".join(f"\0{line}\n\0" if line.lstrip().startswith("#") else line for line in lines)
    return C_TOKENS.sub(lambda match: match[1] or " ", marked).strip()
