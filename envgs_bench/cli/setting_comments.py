"""What the comments behind the fields of a settings class say."""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize


def setting_comments(settings_type: type) -> dict[str, str]:
    """The comment behind each field of a settings class, by the field's name.

    A subclass that changes a default and adds no comment leaves the one it inherits. Fields without a comment, and
    those of classes whose source is not to be had, are left out.
    """
    found: dict[str, str] = {}
    for owner in reversed(settings_type.__mro__):
        if vars(owner).get("__annotations__"):
            found |= _trailing_comments(owner)
    return found


def _trailing_comments(owner: type) -> dict[str, str]:
    """The comments at the end of the fields that the body of the class itself declares."""
    try:
        source = textwrap.dedent(inspect.getsource(owner))
        (definition,) = ast.parse(source).body
    except (OSError, TypeError, SyntaxError):
        return {}
    assert isinstance(definition, ast.ClassDef)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    by_line = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    return {
        node.target.id: by_line[node.end_lineno]
        for node in definition.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.end_lineno in by_line
    }
