"""Packs the journal of a finished run: the same blocks in a sixth to an eighth of the bytes.

A journal under way stays as it is: one write a block, nothing is held back. `pack` writes a new file, reads it again,
compares it byte for byte with the old one, and only then gives it the old one's name. Whatever interrupts it leaves the
old file, and it can be called again.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path

from drivers.journal import Block, Damage, Kind, packed_block, read_blocks, stored_blocks
from drivers.system import hold, sync_folder

FRAMES_AT_ONCE, BLOCKS_AT_ONCE = 1 << 16, 1 << 12
"""Frames and blocks of one packed block, some two minutes of a unit: what a damaged byte costs later."""


def pack(path: Path) -> bool:
    """Pack a journal that nobody writes any more; False where it stays as it is.

    It does where it is written, packed already, empty or damaged (what cannot be read is kept, to be looked at), and
    where the disk does not take the packed one.
    """
    first = next(stored_blocks(path), None)
    if first is None or first.kind is Kind.PACKED:
        return False
    partial = path.with_name(f".{path.name}.part")
    handle = os.open(path, os.O_RDONLY)
    try:
        if not hold(handle):  # a `JournalWriter` has it open
            return False
        damage = Damage()
        with partial.open("wb") as file:
            for number, blocks in enumerate(_groups(read_blocks(path, damage))):
                file.write(packed_block(blocks, number).encoded())
            file.flush()
            os.fsync(file.fileno())
        if damage.skipped_bytes or damage.torn_bytes or not _same(path, partial):
            return False
        partial.chmod(0o644)
        partial.replace(path)
        sync_folder(path.parent)
    except (OSError, ValueError):  # a full disk; frames that are none
        return False
    finally:
        os.close(handle)
        with suppress(OSError):
            partial.unlink(missing_ok=True)
    return True


def _groups(blocks: Iterable[Block]) -> Iterator[list[Block]]:
    """Blocks in order, in groups of bounded size whose frames have records of one size."""
    group: list[Block] = []
    frames = size = 0
    for block in blocks:
        own = len(block.payload) // block.count if block.kind is Kind.FRAMES and block.count else size
        full = frames >= FRAMES_AT_ONCE or len(group) >= BLOCKS_AT_ONCE
        if group and (full or (size and own != size)):
            yield group
            group, frames, size = [], 0, 0
        group.append(block)
        frames, size = frames + block.count * (block.kind is Kind.FRAMES), own
    if group:
        yield group


def _same(path: Path, partial: Path) -> bool:
    """Whether the packed file gives every block of the other one."""
    return all(old == new for old, new in zip_longest(read_blocks(path), read_blocks(partial)))
