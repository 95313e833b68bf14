"""Import paths, by which a run takes methods, data sources and normal estimators that are somebody else's."""

from __future__ import annotations

import importlib
from typing import Any


def load_import_path(path: str) -> Any:
    """What "package.module:name" names.

    Raises:
        ImportError: there is no such module, it cannot be imported, it holds no such name, or `path` has another form.
    """
    module_name, _, name = path.partition(":")
    try:
        return getattr(importlib.import_module(module_name), name)
    except ModuleNotFoundError as error:
        if error.name != module_name.partition(".")[0]:  # of the package, or of what the module itself needs
            raise
        raise ImportError(
            f"{error}: it is neither installed nor in a folder of PYTHONPATH; put PYTHONPATH=. before the command "
            "where the file lies in this folder"
        ) from error
    except ImportError:
        raise
    except (AttributeError, TypeError, ValueError) as error:  # the last two of .a:b and :b
        raise ImportError(str(error)) from error
    except Exception as error:
        raise ImportError(f"its module raises {type(error).__name__}: {error}") from error
