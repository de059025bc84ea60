"""An instrument of a station beside chamber and units: values read, settings written and read back, by SCPI or Modbus.

SCPI goes over a serial line or a TCP socket (pyserial), or over any VISA resource (PyVISA with pyvisa-py; the extra
`instruments`). `*IDN?` is in IEEE 488.2; 9.9E37 for what is beyond the range and 9.91E37 for no number are in SCPI-99
(volume 1, 7.2.1). Modbus goes over the same link as a chamber.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
import time
from dataclasses import KW_ONLY
from functools import cached_property
from typing import Annotated, Any, Protocol
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic.dataclasses import dataclass

from drivers.errors import ConfigError, DriverError, IdentityError, LimitError, LinkError, ReadBackError, one_line
from drivers.modbus import ModbusLink
from drivers.register import STRICT, Register, Text, Value

MODBUS = ("tcp://", "rtu+tcp://", "rtu://")
"""How addresses of Modbus begin."""
IDENTIFY = "*IDN?"
SOCKET = "socket://"
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_NO_NUMBER = 9.9e37
_LONGEST = 1000
_MODEL = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


@dataclass(frozen=True, config=STRICT)
class InstrumentRegister(Register):
    """A register of an instrument, as in a register map."""

    _: KW_ONLY
    meaning: Text = "a value of the instrument"
    """What it is, for messages and people."""
    source: Text = "station file"
    """Where this is written: document and page."""


class Reading(BaseModel):
    """One value that is read again and again: of a SCPI query, or of a Modbus register."""

    model_config = _MODEL

    channel: Text
    """Channel of the run that it becomes."""
    query: Text | None = None
    """SCPI query, such as MEAS:VOLT?"""
    answer: Text = "{value}"
    """What a query is answered with: `{value}` stands for the number, `{any}` for text that may be anything."""
    modbus: InstrumentRegister | None = None
    """Modbus register, described as in a register map."""
    unit: Text | None = None
    """Unit of the number; left out: that of the channel."""
    scale: FiniteFloat = 1.0
    """Value = number x scale + offset, in `unit`."""
    offset: FiniteFloat = 0.0
    """Such as the correction from a calibration certificate."""
    low: FiniteFloat | None = None
    """Lowest value that can be, in the unit of the channel; one below it counts as no answer."""
    high: FiniteFloat | None = None
    """Highest value that can be."""
    period_s: Annotated[float, Field(ge=0.1, le=3600)] = 1.0
    """Time from one reading to the next [s]; the bench asks at most once a second."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Reading:
        _query_or_register(self.query, self.modbus)
        if self.answer.count("{value}") != 1:
            raise ValueError(f"answer is {self.answer!r}: it needs `{{value}}` once, where the number stands")
        if self.modbus is not None and (self.modbus.values or self.modbus.type == "ascii"):
            raise ValueError("a channel is a number: a register with `values` or of type ascii is none")
        if self.scale == 0:
            raise ValueError("scale is 0: every value would be the same")
        return self

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """What the whole answer has to match; its group is the number."""
        text = re.escape(self.answer).replace(re.escape("{value}"), _NUMBER).replace(re.escape("{any}"), ".*?")
        return re.compile(rf"\s*{text}\s*")

    def number(self, said: str) -> float:
        """The number in an answer; LimitError where there is none, or an instrument says that it has none."""
        match = self.pattern.fullmatch(said)
        if match is None:
            raise LimitError(f"{self.query} answers {said!r}, which does not fit {self.answer!r}")
        number = float(match[1])
        if abs(number) >= _NO_NUMBER:
            raise LimitError(f"{self.query} answers {said}: beyond the range of the instrument")
        return number


class Setting(BaseModel):
    """Something that is set and read back: by a SCPI command and query, or in a Modbus register."""

    model_config = _MODEL

    command: Text | None = None
    """SCPI command, such as VOLT 12.0"""
    query: Text | None = None
    """SCPI query that reads it back, such as VOLT?"""
    modbus: InstrumentRegister | None = None
    """Modbus register that is written and read back."""
    value: FiniteFloat | Text
    """What it reads then: a number, or a text; of a register: what is written."""
    tolerance: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    """How far the number that is read back may be off."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Setting:
        _query_or_register(self.query, self.modbus)
        if (self.command is None) != (self.query is None):
            raise ValueError("a SCPI setting needs `command` and the `query` that reads it back")
        if self.modbus is not None and self.modbus.write is None:
            raise ValueError("the register needs `write`: 5 for a coil, 6 or 16 for a holding register")
        return self

    @property
    def what(self) -> str:
        """What is set, for messages."""
        return self.command or f"register {self.modbus.address if self.modbus else ''} = {self.value}"

    def agrees(self, said: Value) -> bool:
        """Whether what was read back is what was set."""
        if self.modbus is not None:
            return self.modbus.agrees(self.value, said) or _near(self.value, said, self.tolerance)
        return str(said).strip() == self.value or _near(self.value, said, self.tolerance)


def _query_or_register(query: str | None, register: Register | None) -> None:
    if (query is None) == (register is None):
        raise ValueError("needs either `query` (SCPI) or `modbus` (a register)")


def _near(wanted: Value, said: Value, tolerance: float) -> bool:
    try:
        return abs(float(said) - float(wanted)) <= tolerance * (1 + 1e-9)
    except ValueError:
        return False


def _text(query: str, raw: bytes) -> str:
    """An answer as text; LinkError for one that is too long to be one."""
    said = raw.decode("ascii", errors="replace").strip()
    if len(said) > _LONGEST:
        raise LinkError(f"{query}: an answer of {len(said)} characters, which begins with {said[:40]!r}")
    return said


class Line(Protocol):
    """Carries SCPI to one instrument. LinkError when it does not."""

    def ask(self, query: str) -> str:
        """The answer to a query, without its end of line."""

    def send(self, command: str) -> None:
        """Send a command, which has no answer."""

    def close(self) -> None:
        """Close it; the next question opens it again."""


class SerialLine:
    """A serial port, or `socket://HOST:PORT`."""

    def __init__(self, address: str, baudrate: int, timeout_s: float) -> None:
        self._where = address, baudrate, timeout_s
        self._port: Any = None

    def ask(self, query: str) -> str:
        """See Line."""
        with self._open() as port:
            port.reset_input_buffer()
            port.write(f"{query}\n".encode("ascii"))
            raw = bytes(port.read_until(b"\n"))
            if not raw.endswith(b"\n"):
                raise LinkError(f"{query}: no answer within {self._where[2]:g} s")
        return _text(query, raw)

    def send(self, command: str) -> None:
        """See Line."""
        with self._open() as port:
            port.write(f"{command}\n".encode("ascii"))

    def close(self) -> None:
        """See Line."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(Exception):
                port.close()

    @contextlib.contextmanager
    def _open(self) -> Any:
        address, baudrate, timeout_s = self._where
        try:
            if self._port is None and address.startswith(SOCKET):
                self._port = _Socket(address, timeout_s)
            elif self._port is None:
                import serial

                self._port = serial.Serial(address, baudrate, timeout=timeout_s, write_timeout=timeout_s)
            yield self._port
        except LinkError:
            self.close()
            raise
        except Exception as error:  # pyserial lets those of termios through
            self.close()
            raise LinkError(f"{address}: {one_line(error)}") from error


class _Socket:
    """A TCP connection, with the methods of a serial port. That of pyserial sleeps and leaks when it is closed."""

    def __init__(self, address: str, timeout_s: float) -> None:
        parts = urlsplit(address)
        self._socket = socket.create_connection((parts.hostname, parts.port), timeout_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a command and its query at once
        self._timeout_s = timeout_s

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def read_until(self, end: bytes) -> bytes:
        """All that comes up to `end`, or within the time-out."""
        found, until_s = b"", time.monotonic() + self._timeout_s
        with contextlib.suppress(TimeoutError):
            while not found.endswith(end):
                self._socket.settimeout(max(until_s - time.monotonic(), 1e-3))
                piece = self._socket.recv(4096)
                if not piece:
                    raise ConnectionError("the instrument closed the connection")
                found += piece
        self._socket.settimeout(self._timeout_s)
        return found

    def reset_input_buffer(self) -> None:
        self._socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while self._socket.recv(4096):
                pass
        self._socket.settimeout(self._timeout_s)

    def close(self) -> None:
        self._socket.close()


class VisaLine:
    """A VISA resource, such as `TCPIP::192.168.1.20::INSTR` or `GPIB0::22::INSTR`."""

    def __init__(self, address: str, baudrate: int, timeout_s: float, library: str = "@py") -> None:
        """ConfigError without PyVISA. `library`: `@py` is pyvisa-py, `@ivi` the library of a maker."""
        try:
            import pyvisa  # noqa: F401
        except ImportError:
            text = f"{address}: a VISA address needs PyVISA: pip install 'gyro-thermal-bench[instruments]'"
            raise ConfigError(f"{text}; or give socket://HOST:PORT or a serial port") from None
        self._address, self._baudrate, self._timeout_s, self._library = address, baudrate, timeout_s, library
        self._manager: Any = None
        self._resource: Any = None

    def ask(self, query: str) -> str:
        """See Line."""
        raw = bytes(self._do(lambda resource: resource.write(query) and resource.read_raw()))
        if not raw.strip():
            raise LinkError(f"{query}: no answer")
        return _text(query, raw)

    def send(self, command: str) -> None:
        """See Line."""
        self._do(lambda resource: resource.write(command))

    def close(self) -> None:
        """See Line."""
        resource, self._resource = self._resource, None
        if resource is not None:
            with contextlib.suppress(Exception):
                resource.close()

    def _do(self, action: Any) -> Any:
        import pyvisa

        try:
            if self._resource is None:
                self._manager = self._manager or pyvisa.ResourceManager(self._library)
                self._resource = self._manager.open_resource(
                    self._address, read_termination="\n", write_termination="\n", timeout=1e3 * self._timeout_s
                )
                if self._address.upper().startswith("ASRL"):
                    self._resource.baud_rate = self._baudrate
            return action(self._resource)
        except Exception as error:  # each library has errors of its own, beside those of PyVISA
            self.close()
            raise LinkError(f"{self._address}: {one_line(error)}") from error


class Instrument:
    """One instrument, over its line or its Modbus link. Nothing is sent before the first call. Not for several threads.

    What it raises says which instrument: LinkError no answer, LimitError a value that cannot be, ReadBackError.
    """

    def __init__(self, name: str, line: Line | ModbusLink, identity: str | None = None) -> None:
        """`identity`: a text that the answer to `*IDN?` has to contain."""
        self.name = name
        self._line, self._identity = line, identity

    def identify(self) -> str:
        """What it says it is (over Modbus nothing); IdentityError when it is another one. Writes nothing."""
        if isinstance(self._line, ModbusLink):
            return ""
        with self._named():
            said = self._line.ask(IDENTIFY)
        if said.count(",") != 3:
            text = f"answers {IDENTIFY} with {said!r}, not with maker, model, serial and version"
            raise IdentityError(f"{self.name} {text}")
        if self._identity is not None and self._identity not in said:
            raise IdentityError(f"{self.name} is {said!r}, the station file says {self._identity!r}")
        return said

    def read(self, reading: Reading) -> float:
        """One value, in the unit of the reading."""
        with self._named():
            if isinstance(self._line, ModbusLink):
                assert reading.modbus is not None  # checked with the file
                number = float(self._line.read(reading.modbus))
            else:
                number = reading.number(self._line.ask(reading.query or ""))
        return number * reading.scale + reading.offset

    def is_set(self, setting: Setting) -> bool:
        """Whether it reads as it would after this setting. Writes nothing."""
        with self._named():
            return setting.agrees(self._read_back(setting))

    def set(self, setting: Setting) -> None:
        """Set it and read it back; ReadBackError when it is not so."""
        with self._named():
            if isinstance(self._line, ModbusLink):
                assert setting.modbus is not None  # checked with the file
                self._line.write(setting.modbus, setting.value)
            else:
                self._line.send(setting.command or "")
            said = self._read_back(setting)
        if not setting.agrees(said):
            raise ReadBackError(
                f"{self.name}: {setting.what} was sent, and {said} is read back instead of {setting.value}"
            )

    def close(self) -> None:
        """Close the line; what was set stays as it is."""
        self._line.close()

    def _read_back(self, setting: Setting) -> Value:
        if isinstance(self._line, ModbusLink):
            assert setting.modbus is not None  # checked with the file
            return self._line.read(setting.modbus)
        return self._line.ask(setting.query or "")

    @contextlib.contextmanager
    def _named(self) -> Any:
        try:
            yield
        except DriverError as error:
            error.args = (f"{self.name}: {error}", *error.args[1:])
            raise


def open_line(
    address: str, *, baudrate: int = 9600, timeout_s: float = 2.0, device: int = 1, library: str = "@py"
) -> Line | ModbusLink:
    """What carries requests to an address: Modbus by its scheme, VISA by its `::`, else a serial port or socket.

    ConfigError for an address that cannot be one.
    """
    if address.startswith(MODBUS):
        return ModbusLink(address, device_id=device, timeout_s=timeout_s, attempts=1)
    if "::" in address:
        return VisaLine(address, baudrate, timeout_s, library)
    try:
        if address.startswith(SOCKET) and not urlsplit(address).port:
            raise ValueError("must name a port, as in socket://192.0.2.20:5025")
    except ValueError as error:
        raise ConfigError(f"address {address!r}: {one_line(error)}") from None
    return SerialLine(address, baudrate, timeout_s)


def plausible(reading: Reading, value: float) -> float:
    """`value`, in the unit of the channel, if it can be; LimitError otherwise."""
    low = -math.inf if reading.low is None else reading.low
    high = math.inf if reading.high is None else reading.high
    if not low <= value <= high:
        raise LimitError(f"{reading.channel} reads {value:g}, the station file allows {low:g} to {high:g}")
    return value
