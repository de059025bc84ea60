"""The simulated controller's own Modbus TCP, byte by byte; other programs read it in test_modbus_chamber."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from drivers.sim.modbus_tcp import ModbusTcp

READ = bytes.fromhex("0007 0000 0006 01 03 0064 0002")
ANSWER = bytes.fromhex("0007 0000 0007 01 03 04 0064 0065")


@pytest.fixture
def server() -> Iterator[ModbusTcp]:
    """Registers 100 to 109, each holding its address; 105 refuses a write."""

    def answer(code: int, address: int, count: int, new: object) -> list[int] | int:
        if new is not None:
            return 3 if address == 105 else []
        return list(range(address, address + count))

    served = ModbusTcp(answer, [(100, 110)], 0, 1)
    yield served
    served.close()


@pytest.fixture
def line(server: ModbusTcp) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", server.port), timeout=5) as line:
        yield line


def heard(line: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size and (more := line.recv(size - len(data))):
        data += more
    return data


def test_a_read_is_answered_as_the_specification_says(line):
    line.sendall(READ)
    assert heard(line, len(ANSWER)) == ANSWER


def test_a_request_in_pieces_is_a_request_and_two_at_once_are_two(line):
    for byte in READ:
        line.sendall(bytes([byte]))
    assert heard(line, len(ANSWER)) == ANSWER
    line.sendall(READ + READ)
    assert heard(line, 2 * len(ANSWER)) == ANSWER + ANSWER


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        ("06 0064 1234", "06 0064 1234"),
        ("10 0064 0002 04 0001 0002", "10 0064 0002"),
        ("10 0069 0001 02 0001", "90 03"),  # refused by the device
        ("10 0064 0002 02 0001", "90 03"),  # fewer bytes than registers
        ("10 0064 0002 04 0001", "90 03"),
        ("03 0064 0000", "83 03"),
        ("03 0064 007e", "83 03"),
        ("03 0064", "83 03"),
        ("04 0064 000b", "84 02"),  # one register too many
        ("03 0063 0001", "83 02"),
        ("06 006e 0001", "86 02"),
        ("01 0064 0001", "81 01"),
        ("2b 0e 01 00", "ab 01"),
    ],
)
def test_each_request_has_its_answer_or_its_exception(line, pdu: str, answer: str):
    asked, expected = bytes.fromhex(pdu), bytes.fromhex(answer)
    line.sendall(b"\0\1\0\0" + (len(asked) + 1).to_bytes(2, "big") + b"\1" + asked)
    assert heard(line, 7 + len(expected)) == b"\0\1\0\0" + (len(expected) + 1).to_bytes(2, "big") + b"\1" + expected


def test_a_request_for_another_device_is_not_answered(line):
    line.sendall(READ[:6] + b"\2" + READ[7:] + READ)
    assert heard(line, len(ANSWER)) == ANSWER


@pytest.mark.parametrize("nonsense", [b"GET / HTTP/1.1\r\n\r\n", b"\0\1\0\0\0\0\1\3", b"\0\1\0\0\xff\xff\1\3"])
def test_a_connection_that_does_not_speak_modbus_is_closed_and_others_live_on(server, line, nonsense: bytes):
    with socket.create_connection(("127.0.0.1", server.port), timeout=5) as other:
        other.sendall(nonsense)
        assert heard(other, 1) == b""
    line.sendall(READ)
    assert heard(line, len(ANSWER)) == ANSWER


def test_closing_ends_open_connections_and_frees_the_port(server, line):
    line.sendall(READ)
    heard(line, len(ANSWER))
    server.close()
    server.close()
    assert heard(line, 1) == b""
