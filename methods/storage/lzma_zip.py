"""Zips whose members are compressed by LZMA, several at a time. `zipfile` reads them; it writes one after another.

Local headers, a central directory and its end are those of PKWARE's APPNOTE 6.3.10, sections 4.3 and 4.4; what stands
before a member's LZMA stream is of its section 5.8. No member, and no archive, may reach 4 GiB: no ZIP64 is written.
"""

from __future__ import annotations

import lzma
import struct
import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

LARGEST = (1 << 32) - 1  # bytes, of a field of the format
VERSION = 63  # 6.3, which has LZMA: what a reader needs
MADE_ON_UNIX = 3 << 8
ENDS_BY_MARK = 1 << 1  # a flag: the stream says itself where it ends
NAME_IS_UTF8 = 1 << 11
METHOD = 14  # LZMA
DATE = 1 << 5 | 1  # 1 January 1980, the earliest that there is
MODE = 0o600 << 16
SMALLEST_DICTIONARY = 1 << 12  # that LZMA knows
LITERAL_BITS, POSITION_BITS = 3, 0  # lc and pb: planes of bytes have no period of four


def zip_of(members: Mapping[str, bytes], threads: int) -> bytes:
    """A zip of these members, in this order, by their names. The same members make the same bytes.

    Raises:
        ValueError: a member or the archive is too large for the format.
    """
    with ThreadPoolExecutor(max(1, threads)) as pool:  # liblzma works without Python's lock
        packed = dict(zip(members, pool.map(_compressed, members.values()), strict=True))
    if sum(map(len, packed.values())) > LARGEST or any(len(content) > LARGEST for content in members.values()):
        raise ValueError("the model has more than 4 GiB: such a model cannot be stored")
    local, central, start = [], [], 0
    for name, content in members.items():
        title, stream = name.encode(), packed[name]
        flags = ENDS_BY_MARK | NAME_IS_UTF8
        sizes = (zlib.crc32(content), len(stream), len(content), len(title), 0)
        common = struct.pack("<HHHHHIIIHH", VERSION, flags, METHOD, 0, DATE, *sizes)
        local += [b"PK\x03\x04", common, title, stream]
        place = struct.pack("<HHHII", 0, 0, 0, MODE, start)
        central += [b"PK\x01\x02", struct.pack("<H", MADE_ON_UNIX | VERSION), common, place, title]
        start += 4 + len(common) + len(title) + len(stream)
    directory = b"".join(central)
    count = len(members)
    end = struct.pack("<4sHHHHIIH", b"PK\x05\x06", 0, 0, count, count, len(directory), start, 0)
    return b"".join([*local, directory, end])


def _compressed(content: bytes) -> bytes:
    """`content` as a zip's LZMA stream: the version of an LZMA SDK, the coder's properties, and what it coded."""
    dictionary = max(SMALLEST_DICTIONARY, len(content))
    coder = {"id": lzma.FILTER_LZMA1, "dict_size": dictionary, "lc": LITERAL_BITS, "lp": 0, "pb": POSITION_BITS}
    properties = struct.pack("<BI", 45 * POSITION_BITS + LITERAL_BITS, dictionary)
    return (
        struct.pack("<BBH", 9, 4, len(properties))
        + properties
        + lzma.compress(content, lzma.FORMAT_RAW, filters=[coder])
    )
