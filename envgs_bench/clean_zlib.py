"""A zlib of its own for what is imported after pycolmap, whose wheel breaks the system's.

pycolmap 4.2 exports the functions of a zlib built into it. Where it is the first import of a process, the system's
libz.so is loaded for it, and calls those functions in place of its own: Pillow then writes a PNG with halves of two
versions, and the process aborts. A second copy of libz.so, bound to itself alone and seen by all that is loaded later,
serves Pillow instead. What was imported between pycolmap and this package keeps what it has.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path

MAPS = Path("/proc/self/maps")  # of Linux; elsewhere a library's calls stay within it


def load_clean_zlib() -> None:
    """Bind libz.so to itself before pycolmap comes, or load the copy where it came first."""
    if "PIL._imaging" in sys.modules or not MAPS.is_file():
        return
    if "pycolmap" not in sys.modules:
        with suppress(OSError):  # where there is none, nothing can be bound to it
            ctypes.CDLL("libz.so.1")
        return
    mapped = {line.split(maxsplit=5)[-1] for line in MAPS.read_text().splitlines() if "/libz.so" in line}
    for library in mapped:
        copy = os.memfd_create("libz")
        try:
            os.write(copy, Path(library).read_bytes())
            ctypes.CDLL(f"/proc/self/fd/{copy}", mode=ctypes.RTLD_GLOBAL)
        except OSError:
            pass  # a system that runs nothing from memory: as it was
        finally:
            os.close(copy)
