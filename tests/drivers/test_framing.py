"""Packets on serial lines and UDP: found in any bytes, as the libraries of others write them."""

import os
import socket
import time
from dataclasses import replace

import numpy as np
import pytest
import sliplib
from crccheck.checksum import Checksum8, ChecksumXor8
from crccheck.crc import Crc16CcittFalse, Crc32
from hypothesis import given
from hypothesis import strategies as st

from drivers.canbus import BusSettings, ProcessCapture
from drivers.errors import ConfigError
from drivers.framing import Check, Deframer, Framing, Number, Sum
from drivers.packet_bus import Chunk, PacketBus
from drivers.sim.ptys import PtyPair
from tests.support.waiting import until

CRC = Check(16, 0x1021, 0xFFFF, order="big")
CRC32 = Check(32, 0x04C11DB7, 0xFFFFFFFF, refin=True, refout=True, xorout=0xFFFFFFFF)
HEADER = Framing("header", b"\xaa\x55", 12, crc=Check(16, 0x1021, 0xFFFF, order="big", start=2))
SIZED = Framing("header", b"\xfa", length_at=Number(1), length_adds=4, id_at=Number(2), crc=CRC)
KINDS = {
    "slip": Framing("slip", crc=CRC),
    "cobs": Framing("cobs", crc=CRC32),
    "header": HEADER,
    "sized": SIZED,
    "datagram": Framing("datagram", crc=CRC),
    "sum": Framing("header", b"\xfa\xff", 12, crc=Sum("negated", start=1)),
}

COBS = [  # Cheshire and Baker 1999, and the examples of Wikipedia's "Consistent Overhead Byte Stuffing"
    (b"\0", b"\x01\x01"),
    (b"\0\0", b"\x01\x01\x01"),
    (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
    (b"\x11\x22\x33\x44", b"\x05\x11\x22\x33\x44"),
    (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
    (bytes(range(1, 255)), b"\xff" + bytes(range(1, 255))),
    (bytes(range(255)), b"\x01\xff" + bytes(range(1, 255))),
    (bytes(range(1, 256)), b"\xff" + bytes(range(1, 255)) + b"\x02\xff"),
    (bytes([*range(2, 256), 0]), b"\xff" + bytes(range(2, 256)) + b"\x01\x01"),
    (bytes([*range(3, 256), 0, 1]), b"\xfe" + bytes(range(3, 256)) + b"\x02\x01"),
]


def found(framing: Framing, *chunks: bytes) -> tuple[list[bytes], list[bytes]]:
    """Packets, and what is broken."""
    deframer = Deframer(framing)
    pieces = [piece for chunk in chunks for piece in deframer.feed(chunk)]
    return [p.packet for p in pieces if p.whole], [p.packet for p in pieces if not p.whole]


@pytest.mark.parametrize(("packet", "coded"), COBS)
def test_cobs_is_that_of_its_authors(packet, coded):
    framing = Framing("cobs", longest=300)
    assert framing.encode(0, packet) == coded + b"\0"
    assert found(framing, coded + b"\0") == ([packet], [])


@given(st.binary(min_size=1, max_size=60))
def test_slip_is_that_of_sliplib(packet):
    framing = Framing("slip")
    wire = b"\xc0" + sliplib.encode(packet) + b"\xc0"
    assert framing.encode(0, packet) == wire
    assert found(framing, wire) == ([packet], [])


@given(st.binary(min_size=3, max_size=40))
def test_the_crc_is_that_of_crccheck(body):
    padded = body + bytes(4)
    assert CRC.of(padded[:-2]) == Crc16CcittFalse.calc(padded[:-4]).to_bytes(2, "big")
    assert CRC32.of(padded) == Crc32.calc(body).to_bytes(4, "little")


@given(st.binary(max_size=40))
def test_sums_are_those_of_crccheck(body):
    packet = body + bytes(1)
    assert Sum("add").of(packet) == bytes([Checksum8.calc(body)])
    assert Sum("xor").of(packet) == bytes([ChecksumXor8.calc(body)])
    assert Sum("add", 2, order="big").of(packet + bytes(1)) == sum(body).to_bytes(2, "big")
    whole = body + Sum("negated").of(packet)
    assert Checksum8.calc(whole) == 0
    assert Checksum8.calc(body + Sum("inverted").of(packet)) == 0xFF


@pytest.mark.parametrize(
    ("kind", "body", "value"),
    [  # the examples of Wikipedia's "Fletcher's checksum"; a poll of UBX-MON-VER (B5 62 0A 04 00 00 0E 34)
        ("fletcher", b"abcde", "F0C8"),
        ("fletcher", b"abcdef", "5720"),
        ("fletcher", b"abcdefgh", "2706"),
        ("fletcher_256", bytes.fromhex("0A040000"), "0E34"),
    ],
)
def test_fletcher_is_that_of_published_examples(kind, body, value):
    assert Sum(kind, 2).of(body + bytes(2)).hex().upper() == value
    assert Sum(kind, 2, order="big").of(b"\xaa" + body + bytes(2)) != bytes.fromhex(value)
    assert Sum(kind, 2, start=1).of(b"\xaa" + body + bytes(2)) == bytes.fromhex(value)


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_packets_are_found_however_their_bytes_are_cut(kind, data):
    framing = KINDS[kind]
    size = st.just(12) if framing.length else st.integers(8, 40)
    payloads = data.draw(st.lists(size.flatmap(lambda n: st.binary(min_size=n, max_size=n)), min_size=1, max_size=6))
    wires = [framing.encode(7, payload) for payload in payloads]
    line = b"".join(wires)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=5)))
    chunks = wires if kind == "datagram" else [line[a:b] for a, b in zip([0, *cuts], [*cuts, len(line)], strict=True)]
    packets, broken = found(framing, *chunks)
    assert (len(packets), broken) == (len(payloads), [])
    if framing.id_at is not None:
        assert {framing.number(packet) for packet in packets} == {7}


@pytest.mark.parametrize("kind", ["slip", "cobs", "header", "sized", "sum"])
def test_one_flipped_bit_costs_one_packet_and_is_told(kind):
    framing = KINDS[kind]
    wires = [framing.encode(1, bytes([1 + n] * 12)) for n in range(5)]
    bad = bytearray(wires[2])
    bad[5] ^= 0x10
    packets, broken = found(framing, *wires[:2], bytes(bad), *wires[3:])
    clean, _ = found(framing, *wires)
    assert packets == clean[:2] + clean[3:]
    assert broken


def test_the_end_of_an_earlier_packet_is_no_fault():
    wires = [HEADER.encode(0, bytes([n] * 12)) for n in range(3)]
    assert found(HEADER, b"".join(wires)[5:])[1] == []


def test_a_line_without_any_packet_does_not_fill_the_memory():
    deframer = Deframer(KINDS["slip"])
    for _ in range(100):
        list(deframer.feed(bytes([1]) * 1000))
    assert len(deframer._rest) <= 2 * KINDS["slip"].room + 1002


def test_what_does_not_fit_a_packet_is_refused():
    with pytest.raises(ConfigError, match="300 does not fit 1 bytes"):
        SIZED.encode(300, bytes(12))


def test_a_serial_line_is_a_bus():
    pair = PtyPair()
    bus = PacketBus(pair.right, HEADER, 115200)
    try:
        end = os.open(pair.left, os.O_RDWR | os.O_NOCTTY)
        for n in range(3):
            os.write(end, HEADER.encode(0, bytes([n] * 12)))
        messages = [bus.recv(5.0) for _ in range(3)]
        os.close(end)
    finally:
        bus.shutdown()
        pair.close()
    assert [message.data[4] for message in messages] == [0, 1, 2]
    assert [message.arbitration_id for message in messages] == [0, 0, 0]
    assert messages[0].timestamp <= messages[1].timestamp <= messages[2].timestamp


def test_packets_that_a_converter_hands_over_at_once_are_not_dated_before_earlier_ones(monkeypatch):
    pair = PtyPair()
    bus = PacketBus(pair.right, HEADER, 1200)
    try:
        packets = [HEADER.encode(0, bytes([n] * 12)) for n in range(4)]
        chunks = [Chunk(packets[0], 100.0), Chunk(b"".join(packets[1:3]), 100.001), Chunk(packets[3], 40.0), None]
        monkeypatch.setattr(bus._line, "read", lambda timeout: chunks.pop(0))
        times = (bus.recv_block()["t_ns"] * 1e-9).tolist()
    finally:
        bus.shutdown()
        pair.close()
    assert times == [100.0, 100.0, 100.001, 40.0], "a clock that was set back is followed"


def test_bytes_over_a_serial_server_are_taken_together():
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = PacketBus(f"socket://127.0.0.1:{server.getsockname()[1]}", HEADER)
        there, _ = server.accept()
        with there:
            there.sendall(HEADER.encode(0, bytes(12)) * 100)
            chunk = bus._line.read(5.0)
        bus.shutdown()
    assert len(chunk.data) == 1200


def test_a_serial_line_that_hangs_up_is_opened_again_when_it_is_back(tmp_path):
    pair, name = PtyPair(), tmp_path / "tty"
    name.symlink_to(pair.right)
    framing = replace(HEADER, crc=replace(HEADER.crc))  # a CRC that was used does not go to another process
    capture = ProcessCapture(BusSettings("packets", str(name), framing=framing), tmp_path / "j", time.monotonic_ns())
    try:
        say(pair, HEADER.encode(0, bytes(12)) * 3)
        until(lambda: capture.health().frames == 3)
        pair.close()
        until(lambda: capture.health().state == "degraded")
        name.unlink()
        pair = PtyPair()
        name.symlink_to(pair.right)
        until(lambda: capture.health().state == "ok")
        say(pair, HEADER.encode(0, bytes(12))[5:] + HEADER.encode(0, bytes(12)) * 2)
        until(lambda: capture.health().frames == 5)
    finally:
        capture.close()
        pair.close()
    assert (capture.health().recoveries, capture.health().error_frames) == (1, 0)


def say(pair, data):
    end = os.open(pair.left, os.O_RDWR | os.O_NOCTTY)
    os.write(end, data)
    os.close(end)


def test_udp_is_a_bus_and_a_broken_datagram_an_error_frame():
    bus = PacketBus("udp://127.0.0.1:0", KINDS["datagram"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(bus._line._socket.getsockname())
        sender.send(KINDS["datagram"].encode(0, bytes(range(20))))
        sender.send(bytes(20))
        messages = [bus.recv(5.0), bus.recv(5.0)]
    bus.shutdown()
    assert bytes(messages[0].data[:18]) == bytes(range(18))
    assert [message.is_error_frame for message in messages] == [False, True]


def test_bytes_that_waited_are_dated_back():
    here, there = (PacketBus("memory:dated", HEADER, baud) for baud in (1000, None))
    there._line.write(HEADER.encode(0, bytes(12)) * 2, 10.0)
    frames = here.recv_block()
    here.shutdown()
    there.shutdown()
    assert np.diff(frames["t_ns"]).tolist() == [pytest.approx(12 * 10 / 1000 * 1e9)]
    assert frames["t_ns"][-1] == 10_000_000_000
