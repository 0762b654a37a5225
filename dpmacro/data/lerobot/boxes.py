"""What the tables of an MP4 file say they hold, compared with what the file can hold, before it is opened.

Four damaged bytes may say that a film has a thousand million frames, and libav takes memory for them all. MP4
files consist of boxes: a size, a name of four letters, and what is in it, at times other boxes.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dpmacro.data.images import DatasetError

__all__ = ["check_tables"]

HOLDERS = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"moof", b"traf", b"mvex"}
DEEPEST = 6  # of them within one another: moov, trak, mdia, minf, stbl, and one to spare
CUT = {
    b"mdat",
    b"free",
    b"skip",
    b"wide",
}  # which may reach beyond the end of a file that was not copied whole
TABLES = {  # where the number of rows stands, where the first row does, and bytes a row
    b"stts": (4, 8, 8),
    b"ctts": (4, 8, 8),
    b"stss": (4, 8, 4),
    b"stps": (4, 8, 4),
    b"stsc": (4, 8, 12),
    b"stco": (4, 8, 4),
    b"co64": (4, 8, 8),
    b"elst": (4, 8, 12),
    b"sbgp": (8, 12, 8),
}
RUNS = {b"stts", b"ctts"}  # whose rows begin with a number of frames
SIZES, SMALL_SIZES, FRAGMENT = b"stsz", b"stz2", b"trun"
FIELDS = 0x100, 0x200, 0x400, 0x800  # flags of a fragment's table, each for four bytes a frame


def check_tables(path: Path) -> None:
    """Raise DatasetError where the file's tables say more than a file of its size can hold.

    Files that are no MP4 pass. Nothing is read but heads of boxes, and those tables that count frames.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        for name, start, end in _boxes(file, path, 0, size, 0):
            wrong = _wrong(file, name, start, end, size)
            if wrong:
                raise DatasetError(
                    f"{path}: its table {name.decode('latin-1')} {wrong}, and the file has {size} bytes; "
                    "record the dataset again"
                )


def _boxes(file: BinaryIO, path: Path, start: int, end: int, depth: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte and end of what is in every box from `start` on, and of the boxes within it."""
    while start + 8 <= end:
        file.seek(start)
        head = file.read(16)
        size, name, first = int.from_bytes(head[:4], "big"), head[4:8], start + 8
        if size == 1:
            size, first = int.from_bytes(head[8:], "big"), start + 16
        elif size == 0 and depth == 0:
            size = end - start
        if size < first - start:
            return  # where libav ends, too
        if start + size > end and not (depth == 0 and name in CUT):
            if depth == 0 and name not in HOLDERS:
                return  # no MP4, or nothing that is read
            wrong = "its part {!r} is larger than what holds it" if depth else "ends within its part {!r}"
            wrong = wrong.format(name.decode("latin-1"))
            raise DatasetError(f"{path}: {wrong}; record the dataset again")
        yield name, first, min(start + size, end)
        if name in HOLDERS and depth < DEEPEST:
            yield from _boxes(file, path, first, start + size, depth + 1)
        start += size


def _wrong(file: BinaryIO, name: bytes, start: int, end: int, size: int) -> str:
    """What is too much in a table of a file of `size` bytes; "" for nothing, and for other boxes."""
    if name in (SIZES, SMALL_SIZES):
        head = _read(file, start, 12)
        each, count = struct.unpack(">II", head[4:])
        bits = 32 if name == SIZES else each & 0xFF
        if name == SIZES and each:
            return f"says that there are {count} frames of {each} bytes" if count * each > size else ""
        return _rows(count, 12, bits, end - start)
    if name == FRAGMENT:
        flags, count = struct.unpack(">II", _read(file, start, 8))
        bits = 32 * sum(bool(flags & field) for field in FIELDS)
        return f"says that there are {count} frames" if count > size else _rows(count, 8, bits, end - start)
    if name not in TABLES:
        return ""
    place, first, each = TABLES[name]
    count = int.from_bytes(_read(file, start, first)[place : place + 4], "big")
    wrong = _rows(count, first, 8 * each, end - start)
    if wrong or name not in RUNS:
        return wrong
    rows = np.frombuffer(_read(file, start + first, 8 * count), ">u4").reshape(-1, 2)
    frames = int(rows[:, 0].sum(dtype=np.int64))
    return f"says that there are {frames} frames" if frames > size else ""


def _rows(count: int, first: int, bits: int, room: int) -> str:
    return f"says that it has {count} rows" if first + count * bits / 8 > room else ""


def _read(file: BinaryIO, start: int, count: int) -> bytes:
    """So many bytes, zeros beyond the end."""
    file.seek(start)
    return file.read(count).ljust(count, b"\0")
