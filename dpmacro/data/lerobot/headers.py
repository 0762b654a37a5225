"""The size of an encoded picture by its header, before a byte of it is decoded; what sizes are read.

A file of a hundred bytes may say that it is 100,000 pixels wide and high, and decoders take memory for it.
"""

import itertools
from typing import Any

__all__ = ["MOST_PIXELS", "most_pixels", "stated_size"]

MOST_PIXELS = 2**26  # 8192 x 8192; decoded it takes 200 MiB
LITTLE, FEW_PIXELS = 2**20, 2**23  # a film of less than 1 MiB; 3840 x 2160
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of JPEG after which the size stands
ALONE = {0x01, *range(0xD0, 0xD9)}  # markers without a length


def most_pixels(size: int) -> int:
    """Pixels that a frame of a film of `size` bytes may have; a decoder keeps up to 17 frames."""
    return FEW_PIXELS if size < LITTLE else MOST_PIXELS


def stated_size(content: Any) -> tuple[int, int] | None:
    """Width and height of a PNG or JPEG file; None for any other, and where the header is cut."""
    view = memoryview(content)
    if bytes(view[:8]) == PNG:
        return (_number(view, 16, 4), _number(view, 20, 4)) if len(view) >= 24 else None
    if bytes(view[:2]) != JPEG:
        return None
    place = 2
    for _ in itertools.repeat(None, len(view)):
        if place + 9 > len(view) or view[place] != 0xFF:
            return None
        marker = view[place + 1]
        if marker in FRAMES:
            return _number(view, place + 7, 2), _number(view, place + 5, 2)
        if marker == 0xFF:
            place += 1
        else:
            place += 2 if marker in ALONE else 2 + _number(view, place + 2, 2)
    return None


def _number(view: memoryview, start: int, size: int) -> int:
    return int.from_bytes(view[start : start + size], "big")
