"""A finished journal is packed: the same blocks, byte for byte, in fewer bytes; what interrupts it costs nothing."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drivers.packing
from drivers.can_record import frame_type, packed, unpacked
from drivers.journal import FRAME, Damage, JournalWriter, Kind, read_blocks, stored_blocks
from drivers.packing import pack


def frames_like_a_gyro(count: int, seed: int = 0) -> np.ndarray:
    """Noise in the low bytes, a counter, a CRC, and every tenth frame another message."""
    random = np.random.default_rng(seed)
    frames = np.zeros(count, dtype=FRAME)
    frames["t_ns"] = np.arange(count) * 2_000_000
    frames["id"], frames["len"] = np.where(np.arange(count) % 10, 0x120, 0x130), 8
    code = np.rint(random.normal(0, 3700, count)).astype("<i4")
    frames["data"][:, :4] = code.view("u1").reshape(-1, 4)
    frames["data"][:, 4:6] = np.arange(count).astype("<u2").view("u1").reshape(-1, 2)
    frames["data"][:, 7] = random.integers(0, 256, count)
    return frames


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    path = tmp_path / "can0.gtbj"
    writer = JournalWriter(path)
    frames = frames_like_a_gyro(60_000)
    writer.append(Kind.META, b'{"run": "x"}', 1, 0.0, 7)
    for start in range(0, len(frames), 600):
        part = frames[start : start + 600]
        writer.append(Kind.FRAMES, part.tobytes(), len(part), float(part["t_ns"][-1]) * 1e-9, 1000 + start)
    writer.append(Kind.EVENT, b'{"text": "end"}', 1, 120.0)
    writer.append(Kind.FRAMES, b"", 0, 121.0)
    writer.close()
    return path


def original(path: Path) -> str:
    """Of the journal as it was written."""
    return hashlib.sha256(b"".join(block.encoded() for block in read_blocks(path))).hexdigest()


def test_a_packed_journal_gives_every_byte_of_the_old_one_in_a_sixth_of_them(journal):
    before, size = hashlib.sha256(journal.read_bytes()).hexdigest(), journal.stat().st_size
    assert pack(journal)
    assert original(journal) == before
    assert journal.stat().st_size < size / 6
    assert {block.kind for block in stored_blocks(journal)} == {Kind.PACKED}
    assert not pack(journal)
    assert [path.name for path in journal.parent.iterdir()] == [journal.name]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.binary(min_size=80, max_size=80), max_size=30), st.sampled_from([8, 64]))
def test_any_frames_come_back(rows, width):
    kind = frame_type(width)
    frames = np.frombuffer(b"".join(row[: kind.itemsize] for row in rows), dtype=kind)
    assert unpacked(packed(frames)).tobytes() == frames.tobytes()


def test_blocks_of_a_bus_with_long_frames_come_back(tmp_path):
    path, wide = tmp_path / "fd.gtbj", np.zeros(50, dtype=frame_type(64))
    wide["len"], wide["data"] = 64, np.arange(64)
    writer = JournalWriter(path)
    for part in (frames_like_a_gyro(30), wide, frames_like_a_gyro(10)):
        writer.append(Kind.FRAMES, part.tobytes(), len(part), 0.0)
    writer.close()
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    assert pack(path)
    assert original(path) == before
    assert [block.frames().dtype.itemsize for block in read_blocks(path)] == [24, 80, 24]


def test_a_journal_with_damage_is_kept_as_it_is(journal):
    data = bytearray(journal.read_bytes())
    data[len(data) // 2] ^= 1
    journal.write_bytes(data)
    assert not pack(journal)
    assert journal.read_bytes() == data


def test_a_journal_that_is_written_is_left_alone(tmp_path):
    writer = JournalWriter(tmp_path / "j")
    writer.append(Kind.EVENT, b"x", 1, 0.0)
    assert not pack(tmp_path / "j")
    writer.close()
    assert pack(tmp_path / "j")


@pytest.mark.parametrize("step", ["write", "compare", "sync"])
def test_what_interrupts_it_leaves_the_old_file_and_it_can_be_done_again(journal, monkeypatch, step):
    before = journal.read_bytes()

    def fails(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        if step == "compare":
            patch.setattr(drivers.packing, "_same", lambda *_: False)
        else:
            patch.setattr(*{"write": (drivers.packing, "packed_block"), "sync": (os, "fsync")}[step], fails)
        assert not pack(journal)
    assert journal.read_bytes() == before
    assert [path.name for path in journal.parent.iterdir()] == [journal.name]
    assert pack(journal)


def test_a_kill_in_the_middle_leaves_a_part_that_the_next_try_replaces(journal):
    partial = journal.with_name(f".{journal.name}.part")
    partial.write_bytes(b"half")
    assert pack(journal)
    assert not partial.exists()


def test_a_damaged_byte_in_a_packed_journal_is_counted(journal):
    assert pack(journal)
    data = bytearray(journal.read_bytes())
    data[len(data) // 2] ^= 1
    journal.write_bytes(data)
    damage = Damage()
    assert list(read_blocks(journal, damage)) == []
    assert damage.skipped_bytes + damage.torn_bytes == len(data)
