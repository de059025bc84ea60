"""Append-only journal of a run: CRC-framed blocks that survive `kill -9` and a power cut.

Each block is written by one `write` call: header with its CRC-32, payload, and a CRC-32 over all. A reader accepts
every block whose CRC is right, resynchronises on the magic after a damaged one, and reports the bytes it skipped.
The header has a separate CRC so that a damaged length cannot make a reader wait for bytes that never arrive. One
writer per file. Readers may follow a file while it grows. `drivers.packing` packs the blocks of a finished journal;
`read_blocks` returns them as they were.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from drivers.can_record import (
    FLAG_ERROR,
    FLAG_EXTENDED,
    FLAG_FAST,
    FLAG_FD,
    FLAG_REMOTE,
    FRAME,
    FrameArray,
    packed,
    records,
    unpacked,
)
from drivers.system import hold

__all__ = [
    "FLAG_ERROR",
    "FLAG_EXTENDED",
    "FLAG_FAST",
    "FLAG_FD",
    "FLAG_REMOTE",
    "FRAME",
    "Block",
    "Damage",
    "FrameArray",
    "JournalTail",
    "JournalWriter",
    "Kind",
    "read_blocks",
]

MAGIC = b"GTBJ"
_HEADER = struct.Struct("<4sHHIIIdQ")  # magic, version, kind, sequence, count, payload bytes, bench time, wall ns
_CRC = struct.Struct("<I")
VERSION = 1
MAX_PAYLOAD = 1 << 24


class Kind(IntEnum):
    """Content of a block."""

    FRAMES = 1  # FRAME records, or longer ones from a bus with CAN FD
    READING = 2  # chamber readings, float64 rows
    EVENT = 3  # one JSON object
    META = 4  # one JSON object: what is needed to decode this file by itself
    TABLE = 5  # encoder readings of the rate table, TABLE records
    PACKED = 6  # blocks of a finished journal
    INSTRUMENT = 7  # readings of instruments, INSTRUMENT records


_KINDS = frozenset(Kind)


@dataclass(frozen=True)
class Block:
    """One block whose CRC was right; `t_s` is bench time [s] at writing."""

    kind: Kind
    sequence: int
    count: int
    t_s: float
    wall_ns: int
    payload: bytes

    def frames(self) -> FrameArray:
        """The records of a FRAMES block, shape (count,)."""
        return records(self.payload, self.count)

    def encoded(self) -> bytes:
        """The block as it is written: header, its CRC, payload, and the CRC of all."""
        size = len(self.payload)
        head = _HEADER.pack(MAGIC, VERSION, self.kind, self.sequence, self.count, size, self.t_s, self.wall_ns)
        head += _CRC.pack(zlib.crc32(head))
        crc = zlib.crc32(self.payload, zlib.crc32(head))
        return b"".join((head, self.payload, _CRC.pack(crc)))


class JournalWriter:
    """Appends blocks; `sync()` makes them survive a power cut."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        hold(self._fd, shared=True)  # a journal that is written is not packed
        self._sequence = 0

    def append(self, kind: Kind, payload: bytes, count: int, t_s: float, wall_ns: int = 0) -> None:
        """Write one block with a single system call; OSError (a full disk) reaches the caller."""
        block = Block(kind, self._sequence, count, t_s, wall_ns, payload).encoded()
        written = os.write(self._fd, block)
        if written != len(block):  # a full disk may store a part of the block; the reader skips it by its CRC
            raise OSError(28, "journal block written only in part (disk full?)", str(self.path))
        self._sequence += 1

    def sync(self) -> None:
        """Force all appended blocks to the disk."""
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Sync and close; a second call does nothing."""
        if self._fd >= 0:
            os.fdatasync(self._fd)
            os.close(self._fd)
            self._fd = -1


class JournalTail:
    """Reads a journal from its start, or follows it while it grows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.skipped_bytes = 0
        self._offset = 0
        self._rest = b""

    def poll(self) -> list[Block]:
        """All complete blocks that were appended since the last call."""
        if not self.path.exists():
            return []
        with self.path.open("rb") as file:
            file.seek(self._offset)
            new = file.read()
        self._offset += len(new)
        data = self._rest + new
        blocks, used, skipped = _parse(data)
        self._rest = data[used:]
        self.skipped_bytes += skipped
        return blocks


@dataclass
class Damage:
    """Bytes that a reader skipped: damaged bytes between blocks, and a torn block at the end."""

    skipped_bytes: int = 0
    torn_bytes: int = 0


def read_blocks(path: Path, damage: Damage | None = None, chunk_bytes: int = 1 << 24) -> Iterator[Block]:
    """All intact blocks of a finished or killed journal, in constant memory; counts the other bytes in `damage`.

    Packed blocks are returned as those that they were made of.
    """
    damage = damage if damage is not None else Damage()
    for block in stored_blocks(path, damage, chunk_bytes):
        if block.kind is not Kind.PACKED:
            yield block
            continue
        try:
            yield from unpacked_blocks(block)
        except (ValueError, struct.error, OSError):  # its CRC is right: it was made wrong
            damage.skipped_bytes += len(block.payload)


def stored_blocks(path: Path, damage: Damage | None = None, chunk_bytes: int = 1 << 24) -> Iterator[Block]:
    """The same with packed blocks as they are in the file."""
    damage = damage if damage is not None else Damage()
    rest = b""
    with path.open("rb") as file:
        while chunk := file.read(chunk_bytes):
            data = rest + chunk
            blocks, used, skipped = _parse(data)
            damage.skipped_bytes += skipped
            yield from blocks
            rest = data[used:]
    blocks, used, skipped = _parse(rest, final=True)
    yield from blocks
    left_out = skipped + len(rest) - used
    if blocks:  # appended after a torn one
        damage.skipped_bytes += left_out
    else:
        damage.torn_bytes += left_out


_HEADS = np.dtype(
    [("kind", "<u2"), ("sequence", "<u4"), ("count", "<u4"), ("size", "<u4"), ("t_s", "<f8"), ("wall_ns", "<u8")]
)
_PARTS = struct.Struct("<II")  # bytes of the heads and of the packed frames; what is left are the other payloads


def packed_block(blocks: Sequence[Block], sequence: int) -> Block:
    """One block that contains these; those with frames must have records of one size."""
    from pyarrow import compress  # slow to import; a capture never needs it

    heads = np.array([(b.kind, b.sequence, b.count, len(b.payload), b.t_s, b.wall_ns) for b in blocks], dtype=_HEADS)
    kept = [block.frames() for block in blocks if block.kind is Kind.FRAMES and block.count]
    frames = packed(np.concatenate([part.view(np.uint8) for part in kept]).view(kept[0].dtype)) if kept else b""
    others = b"".join(b.payload for b in blocks if not (b.kind is Kind.FRAMES and b.count))
    columns = b"".join(heads[name].tobytes() for name in _HEADS.names or ())
    head, rest = (compress(part, "zstd", asbytes=True) for part in (columns, others))
    payload = b"".join((_PARTS.pack(len(head), len(frames)), head, frames, rest))
    return Block(Kind.PACKED, sequence, len(blocks), blocks[-1].t_s, 0, payload)


def unpacked_blocks(block: Block) -> Iterator[Block]:
    """The blocks in a packed one; ValueError where it was made wrong."""
    from pyarrow import Codec

    zstd, data = Codec("zstd"), block.payload
    head_bytes, frame_bytes = _PARTS.unpack_from(data)
    start = _PARTS.size + head_bytes
    columns = zstd.decompress(data[_PARTS.size : start], block.count * _HEADS.itemsize, asbytes=True)
    heads, offset = np.zeros(block.count, dtype=_HEADS), 0
    for name in _HEADS.names or ():
        heads[name] = np.frombuffer(columns, _HEADS[name], block.count, offset)
        offset += _HEADS[name].itemsize * block.count
    framed = (heads["kind"] == Kind.FRAMES) & (heads["count"] > 0)
    frames = unpacked(data[start : start + frame_bytes]).tobytes() if frame_bytes else b""
    others = zstd.decompress(data[start + frame_bytes :], int(heads["size"][~framed].sum()), asbytes=True)
    sources, at = {True: frames, False: others}, {True: 0, False: 0}
    for (kind, sequence, count, size, t_s, wall_ns), is_framed in zip(heads.tolist(), framed.tolist(), strict=True):
        payload = sources[is_framed][at[is_framed] : at[is_framed] + size]
        at[is_framed] += size
        yield Block(Kind(kind), sequence, count, t_s, wall_ns, payload)


def _parse(data: bytes, final: bool = False) -> tuple[list[Block], int, int]:
    """Blocks in `data`, the number of bytes used, and the number of bytes skipped as damaged.

    An incomplete block at the end of `data` stops the search, unless the data is `final`.
    """
    blocks: list[Block] = []
    position = skipped = 0
    while True:
        start = data.find(MAGIC, position)
        if start < 0:
            keep = min(len(MAGIC) - 1, len(data) - position)
            return blocks, len(data) - keep, skipped + len(data) - keep - position
        skipped += start - position
        position = start
        block, end = _block(data, start)
        if block is not None:
            blocks.append(block)
            position = end
        elif end > len(data) and not final:
            return blocks, position, skipped
        else:
            position += 1
            skipped += 1


def _block(data: bytes, start: int) -> tuple[Block | None, int]:
    """The block whose magic is at `start`, None if it is incomplete or damaged; where it (or its header) should end."""
    body = start + _HEADER.size + _CRC.size
    head = data[start:body]
    if len(head) < body - start or zlib.crc32(head[: -_CRC.size]) != _CRC.unpack_from(head, _HEADER.size)[0]:
        return None, body
    _, version, kind, sequence, count, size, t_s, wall_ns = _HEADER.unpack_from(head)
    payload = data[body : body + size]
    end = body + size + _CRC.size
    if data[body + size : end] != _CRC.pack(zlib.crc32(payload, zlib.crc32(head))):
        return None, end
    if version != VERSION or kind not in _KINDS:
        return None, start + 1
    return Block(Kind(kind), sequence, count, t_s, wall_ns, payload), end
