"""The Modbus link of a chamber: the only module that touches a pymodbus client.

pymodbus accepts short and long answers, answers with another function code and, on RTU framing, late answers to an
earlier request. So retries inside pymodbus are off; here every answer is checked against its request, and after any
error the link is resynchronised before the next request:

* Modbus TCP numbers its requests, so a new connection is enough;
* RTU has no numbers, so the link waits for the slowest possible answer, and discards received bytes until the line was
  silent for one whole timeout. Bytes that arrive between two requests are discarded before the second one is sent.

One error remains undetected: an RTU answer that arrives after the slowest possible time, in the middle of the next
exchange, with the right function and length. Hence `slowest_s`, and polled blocks of a fixed shape in register maps.
"""

from __future__ import annotations

import logging
import select
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, Union
from urllib.parse import SplitResult, parse_qsl, urlsplit

import serial

from drivers.backoff import BackOff
from drivers.errors import ConfigError, LinkError, NoConnectionError, RefusedError
from drivers.registers import Register, Value, block_of

if TYPE_CHECKING:  # imported where a link is opened: a rehearsal opens none
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient
    from pymodbus.pdu import ModbusPDU

# pymodbus logs its recent traffic at every error; our errors already describe it.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

EXCEPTIONS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledge",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}
_TRANSIENT = {5, 6, 11}
_MOST_DRAINS = 20
_BUSY_PAUSE_S = 0.05
_MBAP = 7
"""Bytes of the header of Modbus TCP."""
_SERIAL_KEYS = {"baudrate": int, "bytesize": int, "parity": str, "stopbits": int}

_Client: TypeAlias = Union["ModbusTcpClient", "ModbusSerialClient"]


def prepare() -> None:
    """Import what a link needs in advance, for a process that must act without delay."""
    import pymodbus.client  # noqa: F401


@dataclass
class LinkCounters:
    """Events of the link since it was made."""

    requests: int = 0
    faults: int = 0
    retries: int = 0
    connections: int = 0


class ModbusLink:
    """Checked requests to one Modbus device. Not for use by several threads.

    Raises LinkError when no valid answer came within the attempts, RefusedError for exception responses. Each
    request connects if necessary; after an error, the caller waits `back_off.wait_s(failures)` before the next one.
    """

    def __init__(
        self,
        url: str,
        *,
        device_id: int = 1,
        timeout_s: float = 1.5,
        attempts: int = 3,
        slowest_s: float | None = None,
        back_off: BackOff | None = None,
    ) -> None:
        """Prepare a link; the connection is made by the first request.

        `url` is `tcp://host:port` (Modbus TCP), `rtu+tcp://host:port` (RTU frames through a serial gateway) or
        `rtu:///dev/ttyUSB0?baudrate=9600&parity=N&stopbits=1`. `slowest_s` [s] is the latest time of an answer, by
        default twice the timeout; only RTU needs it. Raises ConfigError.
        """
        if not 0 < timeout_s <= 60 or attempts < 1 or not 0 <= device_id <= 247:
            raise ConfigError(
                f"{url}: timeout {timeout_s} s (0 to 60), {attempts} attempts (1..), id {device_id} (..247)"
            )
        self.url = url
        self.back_off = back_off or BackOff()
        self.counters = LinkCounters()
        self._device_id = device_id
        self._attempts = attempts
        self._slowest_s = max(2 * timeout_s if slowest_s is None else slowest_s, timeout_s)
        self._drains = _MOST_DRAINS + round(self._slowest_s / timeout_s)
        self._sent_s = 0.0
        self._received = b""
        self._client, self._numbered = _client(url, timeout_s, self._keep)

    def close(self) -> None:
        """Close the connection; a later request opens it again."""
        self._client.close()  # type: ignore[no-untyped-call]

    def read(self, register: Register) -> Value:
        """Value of one register."""
        return self.read_block([register])[register.name]

    def read_block(self, registers: Iterable[Register]) -> dict[str, Value]:
        """Values of several registers, by name, from one request."""
        members = tuple(registers)
        code, start, count = block_of(members)
        words = self._request(code, start, count)
        return {r.name: r.decode(words[r.address - start : r.end - start]) for r in members}

    def write(self, register: Register, value: Value) -> None:
        """Write one writable register; LimitError before anything is sent. Does not read back."""
        if register.write is None:
            raise ConfigError(f"{register.name} is not a register that may be written")
        self._request(register.write, register.address, register.count, register.encode(value))

    def send(self, register: Register, value: Value) -> None:
        """Write once over a new connection, whatever happened to earlier requests; does not read back.

        NoConnectionError when nothing was sent; LinkError without a valid answer and RefusedError for an exception
        response, although the device may have executed the write.
        """
        if register.write is None:
            raise ConfigError(f"{register.name} is not a register that may be written")
        words = register.encode(value)
        if not self.url.startswith("rtu:"):  # a serial line has no connection
            self.close()
        self.counters.requests += 1
        where = f"{self.url}: function {register.write}, address {register.address}, {register.count} words"
        try:
            self._exchange(register.write, register.address, register.count, words)
        except RefusedError as error:
            raise RefusedError(f"{where}: {error}", error.code) from None
        except LinkError as error:
            self.counters.faults += 1
            self._resynchronise()
            raise type(error)(f"{where}: {error}") from None

    def _request(self, code: int, address: int, count: int, words: Sequence[int] = ()) -> Sequence[int]:
        """One request with a limited number of attempts; returns the words that were read."""
        where = f"{self.url}: function {code}, address {address}, {count} words"
        for attempt in range(1, self._attempts + 1):
            self.counters.requests += 1
            self.counters.retries += attempt > 1
            try:
                return self._exchange(code, address, count, words)
            except RefusedError as error:
                if error.code not in _TRANSIENT:
                    raise RefusedError(f"{where}: {error}", error.code) from None
                if not self._numbered:  # after a gateway times out (11), the device may still answer
                    self._resynchronise()
                if attempt == self._attempts:
                    raise RefusedError(f"{where}: {error} ({attempt} attempts)", error.code) from None
                time.sleep(_BUSY_PAUSE_S * attempt)
            except LinkError as error:
                self.counters.faults += 1
                self._resynchronise()
                if attempt == self._attempts:
                    raise LinkError(f"{where}: {error} ({attempt} attempts)") from None
        raise AssertionError("unreachable")

    def _exchange(self, code: int, address: int, count: int, words: Sequence[int]) -> Sequence[int]:
        from pymodbus.exceptions import ModbusException

        if not self._client.connected:
            if not self._client.connect():
                raise NoConnectionError(f"no connection{unknown_host(self.url)}")
            self.counters.connections += 1
        self._discard_waiting()
        self._sent_s = time.monotonic()
        try:
            answer = self._send(code, address, count, words)
        except (ModbusException, OSError) as error:
            raise LinkError(f"no valid answer: {error}") from error
        except Exception as error:  # pymodbus may raise anything when it decodes garbage
            raise LinkError(f"no valid answer: {type(error).__name__}: {error}") from error
        return self._checked(answer, code, address, count, words)

    def _checked(self, answer: ModbusPDU, code: int, address: int, count: int, words: Sequence[int]) -> Sequence[int]:
        """The words of an answer; RefusedError for an exception, LinkError for what does not answer this request."""
        if answer.function_code == code | 0x80:
            number = answer.exception_code
            raise RefusedError(f"exception {number}, {EXCEPTIONS.get(number, 'unknown')}", number)
        if answer.function_code != code:
            raise LinkError(f"the answer belongs to function {answer.function_code}")
        reads, bits = code in (1, 2, 3, 4), code in (1, 2)
        size = -(-count // 8) if bits else 2 * count
        held: Sequence[int] = [int(bit) for bit in answer.bits] if bits or code == 5 else answer.registers
        if reads and len(held) != (8 * size if bits else count):
            raise LinkError(f"the answer has {len(held)} {'bits' if bits else 'words'}")
        if self._numbered and len(self._received) != _MBAP + (2 + size if reads else 5):
            raise LinkError(f"the answer has {len(self._received)} bytes")
        if reads:
            return held[:count]
        echo = list(held) == list(words) if code in (5, 6) else answer.count == count
        if answer.address != address or not echo:
            raise LinkError("the answer echoes another write")
        return ()

    def _send(self, code: int, address: int, count: int, words: Sequence[int]) -> ModbusPDU:
        client, device = self._client, self._device_id
        calls: dict[int, Callable[[], ModbusPDU]] = {
            1: lambda: client.read_coils(address, count=count, device_id=device),
            2: lambda: client.read_discrete_inputs(address, count=count, device_id=device),
            3: lambda: client.read_holding_registers(address, count=count, device_id=device),
            4: lambda: client.read_input_registers(address, count=count, device_id=device),
            5: lambda: client.write_coil(address, bool(words[0]), device_id=device),
            6: lambda: client.write_register(address, words[0], device_id=device),
            16: lambda: client.write_registers(address, list(words), device_id=device),
        }
        return calls[code]()

    def _keep(self, sending: bool, data: bytes) -> bytes:
        """What was received last: pymodbus ignores bytes behind the part of an answer that it needs."""
        if not sending:
            self._received = data
        return data

    def _resynchronise(self) -> None:
        """Make sure that the next answer belongs to the next request."""
        from pymodbus.exceptions import ModbusException

        if self._numbered or not self._client.connected:
            self.close()
            return
        try:
            for _ in range(self._drains):
                received = self._client.recv(None)  # up to one timeout
                if not received and time.monotonic() >= self._sent_s + self._slowest_s:
                    return
        except (ModbusException, OSError):
            pass
        self.close()

    def _discard_waiting(self) -> None:
        """Discard bytes that an RTU gateway sent without a request; on a serial line pymodbus does it."""
        from pymodbus.client import ModbusSerialClient

        client = self._client
        if self._numbered or isinstance(client, ModbusSerialClient) or client.socket is None:
            return
        try:
            while select.select([client.socket], [], [], 0)[0]:
                if not client.socket.recv(4096):
                    raise LinkError("the gateway closed the connection")
        except (OSError, ValueError) as error:
            raise LinkError(f"connection lost: {error}") from error


def unknown_host(url: str) -> str:
    """`: host NAME is not known`, where the host of an address cannot be resolved; else nothing."""
    host = urlsplit(url).hostname
    if host is None:
        return ""
    try:
        socket.getaddrinfo(host, None)
    except OSError:
        return f": host {host} is not known to this computer"
    return ""


def _client(url: str, timeout_s: float, keep: Callable[[bool, bytes], bytes]) -> tuple[_Client, bool]:
    """The pymodbus client for `url`, and whether its framing numbers the requests."""
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient
    from pymodbus.framer import FramerType

    parts, given = address(url)
    if parts.scheme == "rtu":
        return ModbusSerialClient(parts.path, timeout=timeout_s, retries=0, **given), False
    numbered = parts.scheme == "tcp"
    framer = FramerType.SOCKET if numbered else FramerType.RTU
    port, host = parts.port or (502 if numbered else 10001), parts.hostname or ""
    client = ModbusTcpClient(host, port=port, framer=framer, timeout=timeout_s, retries=0, trace_packet=keep)
    return client, numbered


def address(url: str) -> tuple[SplitResult, dict[str, Any]]:
    """An address and the options of its serial port; ConfigError for one that cannot be. Nothing is opened."""
    try:
        parts = urlsplit(url)
        options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
        if parts.scheme in ("tcp", "rtu+tcp") and parts.hostname and not options and parts.port != 0:
            return parts, {}
        if parts.scheme == "rtu" and parts.path and options.keys() <= _SERIAL_KEYS.keys():
            given = {key: _SERIAL_KEYS[key](text) for key, text in options.items()}
            serial.serial_for_url(parts.path, do_not_open=True, **given)
            return parts, given
    except ValueError as error:
        raise ConfigError(f"address {url!r}: {error}") from error
    raise ConfigError(f"address {url!r}: use tcp://host:port, rtu+tcp://host:port or rtu:///dev/tty?baudrate=9600")
