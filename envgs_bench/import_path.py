"""Import paths, by which a run takes methods, data sources and normal estimators that are somebody else's."""

from __future__ import annotations

import importlib
from typing import Any


def load_import_path(path: str) -> Any:
    """What "package.module:name" names.

    Raises:
        ImportError: there is no such module, it holds no such name, or `path` has another form.
    """
    module_name, _, name = path.partition(":")
    try:
        return getattr(importlib.import_module(module_name), name)
    except (AttributeError, TypeError, ValueError) as error:  # the last two of .a:b and :b
        raise ImportError(str(error)) from error
