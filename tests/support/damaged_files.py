"""Files that promise more than they hold, for readers' tests: written byte by byte, by none of the libraries tested."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\n%%EndComments\nshowpage\n"


def write_promising_png(path: Path, width: int = 60_000, height: int = 60_000) -> Path:
    """A PNG of RGB bytes whose header promises `width`×`height` pixels, with data for none."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(b"")), _chunk(b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    return path


def write_npy_header(path: Path, shape: str, dtype: str = "<f4", values: bytes = b"") -> Path:
    """A NumPy array's file of format 1.0 as far as its header, and then `values`."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + values)
    return path


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
