"""The Modbus link against foreign, slow and broken peers: doubtful answers never become values."""

from __future__ import annotations

import os
import socket
import struct
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from modbus_tk.utils import calculate_crc  # an implementation of the CRC that is not ours nor pymodbus'

from drivers.errors import ConfigError, LimitError, LinkError, RefusedError
from drivers.modbus import ModbusLink
from drivers.registers import load_map
from tests.support import foreign_server

F4T = load_map("watlow_f4t")
PV, SP, MODE = F4T["temperature"], F4T["setpoint"], F4T["mode"]
Reply = bytes | None
Script = list[Callable[[bytes], Reply]]
CLOSE = b""


def mbap(request: bytes, pdu: bytes) -> bytes:
    """Modbus TCP answer to `request`."""
    return request[:4] + struct.pack(">H", len(pdu) + 1) + request[6:7] + pdu


def rtu(pdu: bytes) -> bytes:
    frame = b"\x01" + pdu
    return frame + struct.pack(">H", calculate_crc(frame))


def words(*values: int, code: int = 3) -> bytes:
    return struct.pack(f">BB{len(values)}H", code, 2 * len(values), *values)


def reply(*values: int, code: int = 3) -> Callable[[bytes], Reply]:
    return lambda request: mbap(request, words(*values, code=code))


def refuse(code: int) -> Callable[[bytes], Reply]:
    return lambda request: mbap(request, bytes([request[7] | 0x80, code]))


def close(_: bytes) -> Reply:
    return CLOSE


def silence(_: bytes) -> Reply:
    return None


@contextmanager
def peer(script: Script) -> Iterator[int]:
    """A raw TCP peer that treats one request after the other by its script; any number of connections."""
    listener = socket.create_server(("127.0.0.1", 0))
    connections: list[socket.socket] = []

    def serve() -> None:
        steps = iter(script)
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connections.append(connection)
            while request := _receive(connection):
                answer = next(steps, silence)(request)
                if answer == CLOSE:
                    break
                connection.sendall(answer or b"")
            connection.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        for end in (listener, *connections):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        thread.join()


def _receive(connection: socket.socket) -> bytes:
    try:
        return connection.recv(300)
    except OSError:
        return b""


@contextmanager
def linked(script: Script, scheme: str = "tcp", **options: float) -> Iterator[ModbusLink]:
    with peer(script) as port:
        link = ModbusLink(f"{scheme}://127.0.0.1:{port}", **({"timeout_s": 0.1} | options))  # type: ignore[arg-type]
        yield link
        link.close()


TEMPERATURE = (0x0000, 0x41C8)  # 25.0, low word first


def test_the_request_on_the_wire_is_the_one_of_the_specification():
    seen = []

    def record(request: bytes) -> Reply:
        seen.append(request)
        return mbap(request, words(*TEMPERATURE))

    with linked([record]) as link:
        assert link.read(PV) == 25.0
    assert seen[0][2:] == bytes.fromhex("0000 0006 01 03 0b04 0002")  # 2820 = 0x0B04, two words


def test_a_write_sends_function_16_with_both_words():
    seen = []

    def record(request: bytes) -> Reply:
        seen.append(request)
        return mbap(request, request[7:12])

    with linked([record]) as link:
        link.write(SP, -40.5)
    assert seen[0][7:] == bytes.fromhex("10 0ade 0002 04 0000 c222")


@pytest.mark.parametrize(
    "doubtful",
    [
        reply(0x0000),  # one word for two: pymodbus accepts it
        reply(*TEMPERATURE, 0),
        reply(*TEMPERATURE, code=4),  # another function code: pymodbus accepts it
        close,
        silence,
        lambda request: mbap(bytes([request[0] ^ 1]) + request[1:], words(*TEMPERATURE)),  # another transaction
        lambda request: mbap(request, words(*TEMPERATURE))[:9],  # half an answer
        lambda request: mbap(request, bytes([0x90, 3])),  # exception of another function
    ],
    ids=["short", "long", "function", "closed", "silent", "transaction", "half", "exception of another"],
)
class TestDoubtfulAnswer:
    def test_is_asked_for_again(self, doubtful: Callable[[bytes], Reply]):
        with linked([doubtful, reply(*TEMPERATURE)]) as link:
            assert link.read(PV) == 25.0
            assert (link.counters.faults, link.counters.retries) == (1, 1)

    def test_becomes_an_error_when_it_lasts(self, doubtful: Callable[[bytes], Reply]):
        with linked([doubtful] * 3) as link, pytest.raises(LinkError, match="address 2820, 2 words"):
            link.read(PV)


@pytest.mark.parametrize("code", [1, 2, 3, 4, 8, 10])
def test_a_refusal_is_raised_with_its_code_and_not_repeated(code: int):
    with linked([refuse(code), reply(*TEMPERATURE)]) as link:
        with pytest.raises(RefusedError, match=f"exception {code}") as caught:
            link.read(PV)
        assert caught.value.code == code
        assert link.counters.requests == 1


@pytest.mark.parametrize("code", [5, 6, 11])
def test_a_busy_device_is_asked_again_but_not_for_ever(code: int):
    with linked([refuse(code), refuse(code), reply(*TEMPERATURE)]) as link:
        assert link.read(PV) == 25.0
    with linked([refuse(code)] * 9) as link:
        with pytest.raises(RefusedError):
            link.read(PV)
        assert link.counters.requests == 3


@pytest.mark.parametrize(
    "echo",
    [lambda r: mbap(r, r[7:9] + b"\x00\x01" + r[11:12]), lambda r: mbap(r, b"\x10\x00\x00" + r[10:12])],
    ids=["count", "address"],
)
def test_a_write_that_echoes_another_write_is_no_success(echo: Callable[[bytes], Reply]):
    with linked([echo], attempts=1) as link, pytest.raises(LinkError, match="echoes"):
        link.write(SP, 20.0)


def test_a_single_write_that_echoes_another_value_is_no_success():
    with (
        linked([lambda r: mbap(r, r[7:10] + b"\x00\x63")], attempts=1) as link,
        pytest.raises(LinkError, match="echoes"),
    ):
        link.write(MODE, "auto")


@pytest.mark.parametrize("pdu", [lambda r: r[7:12] + b"\x00\x00", lambda r: r[7:12] + bytes(300)], ids=["2", "300"])
@pytest.mark.parametrize(("register", "value"), [(MODE, "auto"), (SP, 20.0)], ids=["one", "several"])
def test_a_write_whose_answer_is_too_long_is_no_success(register, value, pdu: Callable[[bytes], bytes]):
    with linked([lambda r: mbap(r, pdu(r))], attempts=1) as link, pytest.raises(LinkError, match="bytes"):
        link.write(register, value)


def test_nothing_outside_the_limits_or_the_whitelist_reaches_the_wire():
    with linked([]) as link:
        with pytest.raises(LimitError):
            link.write(SP, 300.0)
        with pytest.raises(ConfigError):
            link.write(PV, 25.0)
        assert link.counters.requests == 0


def test_no_server_is_a_link_error():
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(LinkError, match="no connection"):
        ModbusLink(f"tcp://127.0.0.1:{port}", timeout_s=0.1).read(PV)


def test_a_late_rtu_answer_is_not_taken_for_the_next_register(monkeypatch: pytest.MonkeyPatch):
    """RTU does not number its answers; pymodbus returns the late one as the next register's value."""
    timed_out = threading.Event()

    def late(_: bytes) -> Reply:
        timed_out.wait()
        return rtu(words(*TEMPERATURE))

    def rightly(_: bytes) -> Reply:
        return rtu(words(0x0000, 0xC222))

    with linked([late, rightly], "rtu+tcp", attempts=1) as link:
        receive, calls = link._client.recv, []

        def recv(size: int | None) -> bytes:
            calls.append(size)
            if len(calls) == 2:  # the first ended in the timeout
                timed_out.set()
            return receive(size)

        monkeypatch.setattr(link._client, "recv", recv)
        with pytest.raises(LinkError):
            link.read(PV)
        assert link.read(SP) == -40.5
        assert link.counters.connections == 1  # a serial gateway keeps its one client


def test_rtu_frames_on_a_serial_line():
    master, slave = os.openpty()
    tty.setraw(slave)

    def serve() -> None:
        assert os.read(master, 300) == rtu(bytes.fromhex("03 0b04 0002"))
        os.write(master, rtu(words(*TEMPERATURE)))

    thread = threading.Thread(target=serve)
    thread.start()
    link = ModbusLink(f"rtu://{os.ttyname(slave)}?baudrate=19200&parity=N", timeout_s=2.0)
    try:
        assert link.read(PV) == 25.0
    finally:
        link.close()
        thread.join()
        os.close(master)
        os.close(slave)


def test_a_bad_rtu_checksum_is_no_answer():
    good = rtu(words(*TEMPERATURE))
    with linked([lambda _: good[:-1] + b"\x00", lambda _: good], "rtu+tcp") as link:
        assert link.read(PV) == 25.0
        assert link.counters.faults == 1


def test_our_link_agrees_with_a_server_that_is_not_pymodbus():
    with foreign_server.holding("f4t", 2700, 200) as (slave, port):
        slave.set_values("f4t", 2820, [0x0000, 0xC222])
        link = ModbusLink(f"tcp://127.0.0.1:{port}")
        assert link.read(PV) == -40.5
        link.write(SP, 85.0)
        link.write(MODE, "auto")
        assert slave.get_values("f4t", 2782, 2) == (0x0000, 0x42AA)
        assert slave.get_values("f4t", 2730, 1) == (10,)
        with pytest.raises(RefusedError) as refused:
            link.read(F4T["part_number"])
        assert refused.value.code == 2
        link.close()


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:502",
        "tcp://",
        "udp://host:1",
        "tcp://host:99999",
        "rtu://?baudrate=9600",
        "rtu:///dev/x?speed=9",
        "rtu:///dev/x?baudrate=fast",
    ],
)
def test_a_wrong_address_is_refused_before_anything_is_opened(url: str):
    with pytest.raises(ConfigError):
        ModbusLink(url)
