"""The journal returns every completely written block, whatever happened to the rest of the file."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.journal import FRAME, MAGIC, JournalTail, JournalWriter, Kind, read_blocks

PAYLOADS = [bytes([k]) * (37 * k) for k in range(1, 6)] + [MAGIC * 5, b""]
anywhere = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, bytes, list[int]]:
    path = tmp_path / "a.gtbj"
    writer = JournalWriter(path)
    ends = []
    for k, payload in enumerate(PAYLOADS):
        writer.append(Kind.EVENT, payload, 1, float(k), 1000 + k)
        ends.append(path.stat().st_size)
    writer.close()
    writer.close()
    return path, path.read_bytes(), ends


def payloads(path: Path) -> list[bytes]:
    return [block.payload for block in read_blocks(path, chunk_bytes=50)]


def test_reads_back_what_was_written(written):
    path, _, _ = written
    blocks = list(read_blocks(path))
    assert [block.payload for block in blocks] == PAYLOADS
    assert [(b.sequence, b.t_s, b.wall_ns, b.kind) for b in blocks[:2]] == [
        (0, 0.0, 1000, Kind.EVENT),
        (1, 1.0, 1001, Kind.EVENT),
    ]
    assert payloads(path) == PAYLOADS


def test_frames_keep_their_layout(tmp_path):
    frames = np.zeros(3, dtype=FRAME)
    frames["id"], frames["t_ns"] = [1, 2, 3], [10, 20, 30]
    writer = JournalWriter(tmp_path / "f")
    writer.append(Kind.FRAMES, frames.tobytes(), 3, 0.0)
    writer.close()
    (block,) = read_blocks(tmp_path / "f")
    assert np.array_equal(block.frames(), frames)


@anywhere
@given(data=st.data())
def test_a_torn_tail_costs_only_the_torn_block(written, data):
    path, content, ends = written
    cut = data.draw(st.integers(0, len(content)))
    path.write_bytes(content[:cut])
    assert payloads(path) == PAYLOADS[: sum(end <= cut for end in ends)]


@anywhere
@given(data=st.data())
def test_a_damaged_byte_costs_only_its_block(written, data):
    path, content, ends = written
    at = data.draw(st.integers(0, len(content) - 1))
    damaged = bytearray(content)
    damaged[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(damaged)
    hit = sum(end <= at for end in ends)
    assert payloads(path) == PAYLOADS[:hit] + PAYLOADS[hit + 1 :]
    tail = JournalTail(path)
    assert [block.payload for block in tail.poll()] == PAYLOADS[:hit] + PAYLOADS[hit + 1 :]


@anywhere
@given(cuts=st.lists(st.integers(0, 1200), max_size=8))
def test_a_follower_sees_each_block_once_however_the_file_grows(written, cuts):
    path, content, _ = written
    tail = JournalTail(path)
    seen = []
    for cut in [*sorted(cuts), len(content)]:
        path.write_bytes(content[:cut])
        seen += [block.payload for block in tail.poll()]
    assert seen == PAYLOADS
    assert tail.skipped_bytes == 0


def test_writing_goes_on_after_a_torn_block(written):
    path, content, _ = written
    path.write_bytes(content[:-100])
    whole = payloads(path)
    writer = JournalWriter(path)
    writer.append(Kind.EVENT, b"after", 1, 9.0)
    writer.close()
    assert payloads(path) == [*whole, b"after"]


def test_a_missing_file_is_an_empty_journal_to_a_follower(tmp_path):
    assert JournalTail(tmp_path / "none").poll() == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_heard():
    writer = JournalWriter(Path("/dev/full"))
    with pytest.raises(OSError, match="No space"):
        writer.append(Kind.EVENT, b"x", 1, 0.0)
    os.close(writer._fd)
