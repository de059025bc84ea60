"""A serial CAN adapter: python-can's slcan on a pty, captured by a separate process into a journal."""

from __future__ import annotations

import time

import can
import numpy as np
import pytest

from drivers.canbus import BusSettings, ProcessCapture, open_bus
from drivers.journal import FRAME, Kind, read_blocks
from drivers.sim.slcan_adapter import SlcanAdapter
from tests.support.waiting import until

QUICK = {"sleep_after_open": 0.0}


@pytest.fixture
def wire():
    """Our end of the bus behind the adapter."""
    with can.Bus(interface="virtual", channel="behind slcan") as bus:
        yield bus


@pytest.fixture
def adapter(wire):
    with can.Bus(interface="virtual", channel="behind slcan") as bus:
        adapter = SlcanAdapter(bus)
        yield adapter
        adapter.close()


def message(k: int) -> can.Message:
    return can.Message(arbitration_id=0x120, is_extended_id=False, data=int(k).to_bytes(8, "little"))


def test_frames_flow_both_ways_with_the_bit_rate_of_the_station(adapter, wire):
    with open_bus(BusSettings("slcan", adapter.path, bitrate=500_000, options=QUICK)) as bus:
        until(lambda: adapter.is_open and "S6" in adapter.commands)
        wire.send(can.Message(arbitration_id=0x1ABCDEF, is_extended_id=True, data=[1, 2, 3]))
        wire.send(can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, dlc=4))
        extended, remote = bus.recv(5.0), bus.recv(5.0)
        assert (extended.arbitration_id, extended.is_extended_id, bytes(extended.data)) == (0x1ABCDEF, True, b"\1\2\3")
        assert (remote.arbitration_id, remote.is_remote_frame, remote.dlc) == (0x7FF, True, 4)
        bus.send(message(9))
        sent = wire.recv(5.0)
        assert (sent.arbitration_id, bytes(sent.data)) == (0x120, (9).to_bytes(8, "little"))
    until(lambda: not adapter.is_open)


def test_a_process_captures_every_frame_of_the_adapter(adapter, wire, tmp_path):
    settings = BusSettings("slcan", adapter.path, bitrate=1_000_000, options=QUICK)
    capture = ProcessCapture(settings, tmp_path / "j", time.monotonic_ns())
    try:
        until(lambda: adapter.is_open)
        for k in range(1500):
            wire.send(message(k))
        until(lambda: capture.health().frames == 1500)
        frames = np.concatenate([b.frames() for b in read_blocks(tmp_path / "j") if b.kind is Kind.FRAMES])
        assert frames.dtype == FRAME
        assert np.ascontiguousarray(frames["data"]).view("<u8")[:, 0].tolist() == list(range(1500))
        assert np.all(np.diff(frames["t_ns"]) >= 0)

        adapter.write(b"t1ZZ8garbled\rt12\rt1208AABB\r")  # lines that python-can cannot parse, or that were cut
        wire.send(message(1500))
        until(lambda: capture.health().frames == 1501)
        assert (capture.health().unreadable, capture.health().state) == (3, "ok")

        adapter.close()  # unplugged
        until(lambda: capture.health().state == "degraded")
        health = capture.health()
        assert health.since_s is not None
        assert health.bus == f"CAN bus slcan:{adapter.path}"
    finally:
        capture.close()
    events = [b.payload.decode() for b in read_blocks(tmp_path / "j") if b.kind is Kind.EVENT]
    assert "bus failed" in events[0]
    assert "1501 frames" in events[-1]
