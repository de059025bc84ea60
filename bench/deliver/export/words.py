"""32-bit words: integers, single-precision numbers, bytes and the CRC."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence


def u32(value: int) -> int:
    """A signed or unsigned integer as a word."""
    return value & 0xFFFFFFFF


def i32(word: int) -> int:
    """A word as a signed integer."""
    return word - (1 << 32) if word & 0x80000000 else word


def f32(value: float) -> int:
    """A number rounded to single precision as a word."""
    return int(struct.unpack("<I", struct.pack("<f", value))[0])


def float_of(word: int) -> float:
    """A word as a single-precision number."""
    return float(struct.unpack("<f", struct.pack("<I", word))[0])


def to_bytes(words: Iterable[int]) -> bytes:
    """Words as little-endian bytes."""
    listed = list(words)
    return struct.pack(f"<{len(listed)}I", *listed)


def to_words(content: bytes) -> list[int]:
    """Little-endian bytes as words; an incomplete last word is ignored."""
    return list(struct.unpack(f"<{len(content) // 4}I", content[: len(content) // 4 * 4]))


def crc(words: Sequence[int]) -> int:
    """CRC-32 (zlib) over the bytes of the words."""
    return zlib.crc32(to_bytes(words))
