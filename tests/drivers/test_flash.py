"""Flashing a calibration: whatever fails, the unit keeps a complete one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from drivers import coefficients, flash_objects
from drivers.errors import IdentityError, LimitError, LinkError, ReadBackError, RefusedError
from drivers.flash_objects import Memory
from drivers.sim.eeprom import Eeprom, PowerLostError
from drivers.sim.memory import CalibrationMemory
from tests.support import flash_bench
from tests.support.flash_bench import SERIAL, Counting, KilledError, World, image

OLD, NEW = image(id_=1), image(id_=2, shift_dps=0.01)
WAYS = [("canopen", "segmented"), ("canopen", "expedited"), ("uds", "")]


def flashed(world, content, transfer="segmented", wrap=lambda bus: bus, **more):
    with world.store(wrap, transfer) as store:
        return store.program(content, **more)


def in_force(path, serial: int = SERIAL) -> bytes:
    """Image that the unit corrects with after a power cycle; empty: none."""
    memory = CalibrationMemory(Eeprom(path), serial)
    return memory.eeprom.image(memory.active) if memory.active else b""


@pytest.fixture
def calibrated(tmp_path):
    """EEPROM file of a unit that holds the old calibration."""
    path = tmp_path / "unit.eeprom"
    world = World(path)
    flashed(world, OLD)
    world.close()
    assert in_force(path) == OLD
    return path


@pytest.mark.parametrize(("protocol", "transfer"), WAYS)
def test_a_calibration_is_written_verified_and_in_force(tmp_path, protocol, transfer):
    path = tmp_path / "unit.eeprom"
    world = World(path, protocol)
    archived, steps = [], []
    first = flashed(world, OLD, transfer, archive=archived.append, onlooker=steps.append)
    second = flashed(world, NEW, transfer, archive=archived.append)
    assert archived == [b"", OLD]
    assert steps == list(coefficients.LIMITS_S) == list(first.took_s)
    assert (first.old_bank, first.bank, first.old_set, first.new_set) == (0, 1, 0, 1)
    assert (second.old_bank, second.bank, second.old_set, second.new_set) == (1, 2, 1, 2)
    assert second.crc == zlib.crc32(NEW[:-4])
    assert in_force(path) == NEW
    world.close()


def test_another_process_finds_what_was_written(calibrated):
    world = World(calibrated)
    with world.store() as store:
        assert store.active() == 1
        assert store.read(1) == OLD
        assert store.heartbeat().coefficient_set == 1
    world.close()


@pytest.mark.parametrize(("protocol", "transfer"), WAYS)
@pytest.mark.slow
def test_a_bench_killed_before_any_frame_leaves_a_whole_calibration(calibrated, protocol, transfer):
    """At every frame boundary: before the switch the old calibration is in force, afterwards the new one."""
    start = calibrated.read_bytes()
    counts, world = [], World(calibrated, protocol)
    flashed(world, NEW, transfer, lambda bus: counts.append(Counting(bus)) or counts[0])
    world.close()
    frames = counts[0].sent
    left = []
    for last in range(frames):
        calibrated.write_bytes(start)
        world = World(calibrated, protocol)
        with pytest.raises(KilledError):
            flashed(world, NEW, transfer, lambda bus, last=last: Counting(bus, last))
        world.clock.sleep_until(world.clock.now() + 0.1)  # the unit finishes what it has received
        world.close()
        left.append(in_force(calibrated))
    turned = left.index(NEW)
    assert left[:turned] == [OLD] * turned
    assert left[turned:] == [NEW] * (frames - turned)
    assert 0 < turned < frames


def test_a_flash_after_a_killed_one_succeeds(calibrated):
    world = World(calibrated)
    with pytest.raises(KilledError):
        flashed(world, NEW, wrap=lambda bus: Counting(bus, 20))
    done = flashed(world, NEW)
    world.close()
    assert done.old == OLD
    assert in_force(calibrated) == NEW


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_a_bench_killed_while_a_unit_goes_back_leaves_one_of_the_two_calibrations(calibrated, protocol):
    world = World(calibrated, protocol)
    flashed(world, NEW)
    world.close()
    start, left, ended = calibrated.read_bytes(), [], False
    while not ended:
        calibrated.write_bytes(start)
        world = World(calibrated, protocol)
        try:
            with world.store(lambda bus: Counting(bus, 3 * len(left))) as store:
                ended = store.restore(lambda done, previous: None).bank == 1
        except KilledError:
            world.clock.sleep_until(world.clock.now() + 0.1)
        world.close()
        left.append(in_force(calibrated))
    turned = left.index(OLD)
    assert 0 < turned < len(left) - 1
    assert left == [NEW] * turned + [OLD] * (len(left) - turned)


SCRIPT = """
import os, signal, sys
sys.path[:0] = [{tests!r}]
from tests.support import flash_bench
import pathlib
class Dying(flash_bench.Counting):
    def send(self, message):
        if self.sent == {last}:
            os.kill(os.getpid(), signal.SIGKILL)
        super().send(message)
world = flash_bench.World(pathlib.Path({path!r}))
with world.store(Dying) as store:
    store.program(flash_bench.image(id_=2, shift_dps=0.01))
"""


@pytest.mark.parametrize("last", [12, 40])
def test_a_process_killed_with_sigkill_leaves_the_old_calibration(calibrated, last):
    script = SCRIPT.format(tests=str(Path(__file__).parents[2]), path=str(calibrated), last=last)
    ended = subprocess.run([sys.executable, "-c", script], check=False, env={**os.environ}, capture_output=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr.decode()
    assert in_force(calibrated) == OLD
    assert calibrated.read_bytes() != b""


def test_power_lost_at_any_byte_of_a_write_leaves_a_whole_calibration(calibrated):
    """Erasing, writing and the switch itself; torn at every byte of head and switch, and at many between."""

    def renew(eeprom):
        eeprom.erase(2)
        eeprom.put(2, 0, NEW)
        eeprom.turn(2)

    start, left = calibrated.read_bytes(), []
    total = flash_objects.BANK_BYTES + len(NEW) + 4
    for bytes_left in (*range(40), *range(40, total - 40, 61), *range(total - 40, total)):
        calibrated.write_bytes(start)
        eeprom = Eeprom(calibrated)
        eeprom.writable = bytes_left
        with pytest.raises(PowerLostError):
            renew(eeprom)
        left.append(in_force(calibrated))
    assert set(left[:-3]) == {OLD}
    assert set(left[-3:]) <= {OLD, NEW}  # the last bytes of the switch
    calibrated.write_bytes(start)
    renew(Eeprom(calibrated))
    assert in_force(calibrated) == NEW


def test_a_unit_that_loses_power_in_mid_write_keeps_its_calibration_and_the_error_says_so(calibrated):
    world = World(calibrated)
    world.memory.eeprom.writable = flash_objects.BANK_BYTES + 60
    with pytest.raises(LinkError, match=r"step 'write' failed: .*; the unit is unchanged \(the calibration in bank 1"):
        flashed(world, NEW)
    assert world.memory.active == 1
    assert world.wire.coefficient_set == 1
    world.close()
    assert in_force(calibrated) == OLD


@pytest.mark.parametrize(("protocol", "frames"), [("canopen", 45), ("uds", 22)])
def test_a_cable_that_breaks_in_mid_write(calibrated, protocol, frames):
    world = World(calibrated, protocol)
    with pytest.raises(LinkError, match=r"step 'write' failed: .*no .*; the unit is unchanged"):
        flashed(world, NEW, wrap=lambda bus: Counting(bus, frames, cut=True))
    world.close()
    assert in_force(calibrated) == OLD


def test_a_silent_unit_ends_by_the_time_limit_of_its_step(calibrated):
    world = World(calibrated)
    world.wire.silent = True
    with pytest.raises(LinkError, match=r"step 'serial number' failed: .*no heartbeat within 3 s; nothing was written"):
        flashed(world, NEW)
    assert world.clock.now() < sum(coefficients.LIMITS_S.values())
    world.close()


def test_every_step_has_a_time_limit(calibrated, monkeypatch):
    monkeypatch.setitem(coefficients.LIMITS_S, "write", 0.2)
    world = World(calibrated)
    with pytest.raises(LinkError, match=r"step 'write' failed: .*time limit reached; the unit is unchanged"):
        flashed(world, NEW)
    world.close()


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_the_wrong_unit_is_refused_before_anything_is_written(calibrated, protocol):
    before = calibrated.read_bytes()
    world = World(calibrated, protocol)
    with pytest.raises(IdentityError, match=r"serial number in its memory is 7, the image is for 8; nothing was wri"):
        flashed(world, image(serial=8))
    world.close()
    assert calibrated.read_bytes() == before


def test_what_the_archive_raises_ends_it_before_anything_is_written(calibrated):
    before = calibrated.read_bytes()
    world = World(calibrated)

    def refuse(old):
        raise KeyError(len(old))

    with pytest.raises(KeyError):
        flashed(world, NEW, archive=refuse)
    world.close()
    assert calibrated.read_bytes() == before


def test_a_word_that_the_memory_does_not_keep_is_named(calibrated, monkeypatch):
    world = World(calibrated)
    put = world.memory.eeprom.put

    def stuck(bank, at, data):
        put(bank, at, bytes(b & 0xFE if at + i == 81 else b for i, b in enumerate(data)))

    monkeypatch.setattr(world.memory.eeprom, "put", stuck)
    content = bytearray(image(id_=3, created=1_700_000_001))
    content[81] |= 1  # word 20
    content[-4:] = zlib.crc32(content[:-4]).to_bytes(4, "little")
    with pytest.raises(ReadBackError, match=r"step 'read back' failed: word 20 reads back .*; the unit is unchanged"):
        flashed(world, bytes(content))
    world.close()
    assert in_force(calibrated) == OLD


def test_a_crc_that_the_unit_computes_otherwise_ends_it(calibrated, monkeypatch):
    world = World(calibrated)
    monkeypatch.setattr(world.memory.eeprom, "crc", lambda bank: 0x1234)
    with pytest.raises(ReadBackError, match="step 'CRC' failed: the unit computes 0x00001234"):
        flashed(world, NEW)
    world.close()
    assert in_force(calibrated) == OLD


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_an_image_that_the_unit_does_not_accept_is_never_switched_to(calibrated, protocol):
    content = bytearray(NEW)
    content[8] = 9  # an unknown form, with a CRC that fits
    content[-4:] = zlib.crc32(content[:-4]).to_bytes(4, "little")
    world = World(calibrated, protocol)
    with pytest.raises(RefusedError, match="step 'switch' failed"):
        flashed(world, bytes(content))
    world.close()
    assert in_force(calibrated) == OLD


def test_a_reset_that_never_comes_is_told(calibrated, monkeypatch):
    world = World(calibrated)
    with world.store() as store:
        monkeypatch.setattr(store, "reset", lambda: None)
        with pytest.raises(LinkError, match=r"step 'heartbeat' failed: .*no boot-up heartbeat .*; the new calibration"):
            store.program(NEW)
    world.close()
    assert in_force(calibrated) == NEW  # the power cycle that the text asks for


def test_the_bank_in_force_cannot_be_written(calibrated):
    for protocol in ("canopen", "uds"):
        world = World(calibrated, protocol)
        with world.store() as store, pytest.raises(RefusedError):
            store.put_image(1, NEW)
        world.close()
    assert in_force(calibrated) == OLD


def test_an_image_that_is_none_is_not_sent(calibrated):
    world = World(calibrated)
    for content in (b"", bytes(50), bytes(flash_objects.BANK_BYTES + 4), NEW + b"x"):
        with pytest.raises(LimitError, match="a bank takes whole words"):
            flashed(world, content)
    world.close()


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_compensation_goes_off_until_the_next_reset(calibrated, protocol):
    world = World(calibrated, protocol)
    with world.store() as store:
        store.compensate(False)
        assert store.heartbeat().coefficient_set == 0
        assert store.number(Memory.SET) == 1
        store.reset()
        store.line.wait(lambda: store.line.boots > 0, 2.0, "boot")
        assert store.heartbeat().coefficient_set == 1
    world.close()


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_a_blank_unit_cannot_be_told_to_compensate(protocol):
    world = World(None, protocol)
    with world.store() as store, pytest.raises(RefusedError):
        store.compensate(True)
    world.close()


def test_a_rotten_bank_falls_back_to_the_other_one(calibrated):
    world = World(calibrated)
    flashed(world, NEW)
    world.close()
    content = bytearray(calibrated.read_bytes())
    content[content.rindex(NEW) + 20] ^= 1
    calibrated.write_bytes(content)
    assert in_force(calibrated) == OLD


def test_requests_that_make_no_sense_are_answered_and_harm_nothing(calibrated):
    world = World(calibrated)
    sdo, uds = world.port._sdo, world.port._uds
    assert sdo.answer(bytes([0x40, 0, 0x30, 0, 0, 0, 0, 0]))[4:] == (0x06020000).to_bytes(4, "little")
    assert sdo.answer(bytes([0x00, *[0] * 7]))[0] == 0x80  # a segment of nothing
    assert sdo.answer(bytes([0xC0, *[0] * 7]))[0] == 0x80  # block transfer
    assert sdo.answer(b"\x80" + bytes(7)) is None
    assert sdo.answer(b"") is None
    assert list(uds.answer(bytes([3, 0x22, 0, 1]))) == [bytes([3, 0x7F, 0x22, 0x31])]
    assert list(uds.answer(bytes([2, 0x99, 0]))) == [bytes([3, 0x7F, 0x99, 0x11])]
    assert list(uds.answer(b"")) == []
    assert list(uds.answer(bytes([0x25, 1, 2]))) == []  # a consecutive frame of nothing
    world.close()
    assert in_force(calibrated) == OLD
    assert flash_bench.SERIAL == SERIAL
