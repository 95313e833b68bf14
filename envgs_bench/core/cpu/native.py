"""The C++ extension, compiled for each kind of CPU or, in place, for the machine's own: which module this one runs.

`$ENVGS_BENCH_CPU_TARGET` names another than the best, to repeat what a lesser machine computed: results of two targets
differ in their last bits. It is read once, when the backend is first imported.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from hashlib import sha256
from pathlib import Path
from types import ModuleType

VARIABLE = "ENVGS_BENCH_CPU_TARGET"
FOLDERS = (Path(__file__).parent, Path(__file__).parents[1] / "kernels")  # of the sources
WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")  # how threads wait, where somebody has said so


def load() -> tuple[str, ModuleType]:
    """The target's name and its module, as described in _native.pyi.

    Raises:
        ImportError: this CPU does not run the target asked for, or none, a module is missing, or the sources beside
            this file are others than those that were compiled.
    """
    try:
        from . import _targets
    except ImportError as error:
        raise ImportError(f"{error}; reinstall the package with a C++20 compiler present") from error
    if (FOLDERS[0] / "bindings.cpp").is_file() and sources_digest() != getattr(_targets, "SOURCES_DIGEST", ""):
        raise ImportError("it was compiled from other sources than this checkout has: install the package again")
    supported = _targets.supported()
    if not supported:
        raise ImportError("it needs a CPU of x86-64-v2, which has SSE4.2, or newer")
    compiled = [target for target in supported if importlib.util.find_spec(_module_of(target))]
    if not compiled:
        raise ImportError(
            f"it was compiled for another kind of CPU, this one runs {', '.join(supported)}: install it on this machine"
        )
    target = os.environ.get(VARIABLE) or compiled[0]
    if target not in compiled:
        raise ImportError(f"${VARIABLE} is {target}, this CPU runs {', '.join(compiled)}: choose one of these")
    module = importlib.import_module(_module_of(target))
    if not any(name in os.environ for name in WAITING):
        module.sleep_while_waiting()
    return target, module


def sources_digest() -> str:
    """Of the sources, as CMakeLists.txt computes it."""
    files = [file for folder in FOLDERS for file in sorted(folder.iterdir()) if file.suffix in (".cpp", ".h")]
    return sha256("".join(sha256(file.read_bytes()).hexdigest() for file in files).encode()).hexdigest()


def _module_of(target: str) -> str:
    return f"{__package__}._native_{target.replace('-', '_')}"
