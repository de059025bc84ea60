"""Packets of a serial line or of UDP as frames of a python-can bus, so that everything behind it is as on CAN.

A packet is a frame with its number as identifier and up to 248 bytes of data; bytes that are no whole packet are an
error frame with the first eight of them. The channel is a serial port or any URL of pyserial, `udp://[HOST]:PORT` to
listen at, `daq:NAME/DEVICE` for a device that a package of others opens, or `memory:NAME`, a line inside this process
that keeps the time stamps of its sender.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections import defaultdict, deque
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol
from urllib.parse import urlsplit

import can
import serial

from drivers.can_record import FLAG_ERROR, FLAG_EXTENDED
from drivers.daq import SCHEME, DaqLine
from drivers.errors import ConfigError, one_line
from drivers.frames import NO_FRAMES, to_frames
from drivers.framing import Deframer, Framing
from drivers.journal import FrameArray

INTERFACE = "packets"
_BITS_PER_BYTE = 10  # with start bit and stop bit
_BROKEN_BYTES = 8
_KEEP_ALIVE = {"TCP_KEEPIDLE": 1, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 2}
"""A server that is gone is noticed within 3 s, before its silence ends a run."""
_MOST_BYTES = 4096


class Chunk(NamedTuple):
    """Bytes, and the time of the last one [s]."""

    data: bytes
    t_s: float


class Line(Protocol):
    """What carries the bytes."""

    def read(self, timeout: float | None) -> Chunk | None:
        """What arrives within a time [s]; None: nothing."""

    def write(self, data: bytes, t_s: float) -> None:
        """Send bytes; `t_s` is when, for lines that carry it."""

    def close(self) -> None:
        """Hang up."""


class SerialLine:
    """A serial port, or another URL of pyserial."""

    def __init__(self, channel: str, baudrate: int, options: Mapping[str, Any]) -> None:
        self._port = serial.serial_for_url(channel, baudrate=baudrate, **options)
        self._counts = not channel.startswith("socket:")
        """Whether it says how many bytes wait, and not only that some do."""
        if not self._counts:
            _keep_alive(self._port.fileno())

    def read(self, timeout: float | None) -> Chunk | None:
        """What arrives within a time [s]; None: nothing."""
        self._port.timeout = timeout
        data = self._port.read(max(self._port.in_waiting, 1))
        if data and not self._counts:
            self._port.timeout = 0
            data += self._port.read(_MOST_BYTES)
        return Chunk(data, time.time()) if data else None

    def write(self, data: bytes, t_s: float) -> None:
        """Send bytes."""
        self._port.write(data)

    def close(self) -> None:
        """Hang up."""
        self._port.close()


def _keep_alive(descriptor: int) -> None:
    """Have the system ask a TCP server that sends nothing whether it is still there: reading alone never tells."""
    with socket.fromfd(descriptor, socket.AF_INET, socket.SOCK_STREAM) as line:  # a copy, of the same connection
        line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in _KEEP_ALIVE.items():
            if hasattr(socket, option):
                line.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)


def refusal(channel: str, baudrate: int | None, options: Mapping[str, Any]) -> str | None:
    """Why a channel of packets can never be opened, whatever is connected; None: it may be there."""
    scheme = channel.partition(":")[0]
    if scheme in ("memory", "daq"):
        return None
    try:
        if scheme in ("udp", "udp-to", "socket") and not urlsplit(channel).port:
            return f"is {channel!r}: {_NO_PORT}"
        if scheme in ("udp", "udp-to"):
            return None
        serial.serial_for_url(channel, baudrate=baudrate or 115_200, do_not_open=True, **options)
    except (ValueError, TypeError) as error:
        return f"is {channel!r}: {one_line(error)}; see `channel`, `bitrate` and `options`"
    return None


_NO_PORT = "must name a port, as in udp://0.0.0.0:5005"


class UdpLine:
    """A UDP port that is listened at; with `udp-to://HOST:PORT` one that is sent to."""

    def __init__(self, channel: str) -> None:
        url = urlsplit(channel)
        host, port = url.hostname or "0.0.0.0", url.port
        if port is None:
            raise ConfigError(f"channel {channel}: {_NO_PORT}")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            (self._socket.connect if url.scheme == "udp-to" else self._socket.bind)((host, port))
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout: float | None) -> Chunk | None:
        """The next datagram within a time [s]; None: nothing."""
        self._socket.settimeout(timeout)
        try:
            return Chunk(self._socket.recv(1 << 16), time.time())
        except (TimeoutError, BlockingIOError):
            return None

    def write(self, data: bytes, t_s: float) -> None:
        """Send a datagram; nobody need listen."""
        with contextlib.suppress(ConnectionRefusedError):
            self._socket.send(data)

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


class MemoryLine:
    """A line inside this process; everybody else on it gets what is written."""

    _members: ClassVar[defaultdict[str, list[MemoryLine]]] = defaultdict(list)
    _lock = threading.Lock()

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._chunks: deque[Chunk] = deque()
        self._arrived = threading.Condition()
        with self._lock:
            self._members[channel].append(self)

    def read(self, timeout: float | None) -> Chunk | None:
        """What was written next, within a time [s]; None: nothing."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._chunks), timeout)
            return self._chunks.popleft() if self._chunks else None

    def write(self, data: bytes, t_s: float) -> None:
        """Send bytes with their time."""
        with self._lock:
            others = [line for line in self._members[self._channel] if line is not self]
        for line in others:
            with line._arrived:
                line._chunks.append(Chunk(data, t_s))
                line._arrived.notify_all()

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        with self._lock:
            if self in self._members[self._channel]:
                self._members[self._channel].remove(self)
            if not self._members[self._channel]:
                del self._members[self._channel]


class _Daq:
    """A data acquisition device, which is only read."""

    def __init__(self, channel: str, options: dict[str, Any], length: int | None) -> None:
        self._line = DaqLine(channel, options, length)

    def read(self, timeout: float | None) -> Chunk | None:
        """The next sample within a time [s]; None: nothing."""
        found = self._line.read(timeout)
        return None if found is None else Chunk(*found)

    def write(self, data: bytes, t_s: float) -> None:
        """Nothing is sent to it."""

    def close(self) -> None:
        """Release it."""
        self._line.close()


class PacketBus(can.BusABC):
    """Packets of a line, as a bus; nothing is filtered: a line carries what its one unit sends."""

    def __init__(self, channel: str, framing: Framing, baudrate: int | None = None, **options: Any) -> None:
        """OSError where the line does not open; ConfigError or ValueError for a channel that cannot be one."""
        self.channel_info = f"packets on {channel}"
        self._framing, self._deframer = framing, Deframer(framing)
        self._record = struct.Struct(f"<qIBBBB{framing.room}s")
        self._ready: deque[tuple[float, int, int, bytes]] = deque()  # time, number, flags, data
        self._byte_s = 0.0 if baudrate is None else _BITS_PER_BYTE / baudrate
        self._last_s = 0.0
        if channel.startswith("memory:"):
            self._line: Line = MemoryLine(channel)
        elif channel.startswith(SCHEME):
            self._line = _Daq(channel, options, framing.length)
        elif channel.startswith(("udp:", "udp-to:")):
            self._line = UdpLine(channel)
        else:
            self._line = SerialLine(channel, baudrate or 115_200, options)
        super().__init__(channel=channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame as a packet."""
        packet = self._framing.encode(msg.arbitration_id, bytes(msg.data))
        self._line.write(packet, msg.timestamp)

    def send_block(self, frames: FrameArray) -> None:
        """Send FRAME records (n,) with their own time stamps."""
        room, data = frames.dtype["data"].itemsize, frames["data"].tobytes()
        heads = zip(frames["t_ns"].tolist(), frames["id"].tolist(), frames["len"].tolist(), strict=True)
        for row, (t_ns, number, length) in enumerate(heads):
            packet = self._framing.encode(number, data[room * row : room * row + length])
            self._line.write(packet, t_ns * 1e-9)

    def recv_block(self, timeout: float | None = 0.0) -> FrameArray:
        """All packets that have arrived (n,), waiting up to `timeout` [s] for the first bytes."""
        while (chunk := self._line.read(timeout)) is not None:
            self._take(chunk)
            timeout = 0.0
        records = [
            self._record.pack(round(t_s * 1e9), number, flags, len(data), 0, 0, data)
            for t_s, number, flags, data in self._ready
        ]
        self._ready.clear()
        return to_frames(records) if records else NO_FRAMES

    def shutdown(self) -> None:
        """Hang up; a second call does nothing."""
        self._line.close()
        super().shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        until_s = None if timeout is None else time.monotonic() + timeout
        while not self._ready:
            chunk = self._line.read(None if until_s is None else max(until_s - time.monotonic(), 0.0))
            if chunk is None:
                return None, True
            self._take(chunk)
        t_s, number, flags, data = self._ready.popleft()
        message = can.Message(
            timestamp=t_s, arbitration_id=number, data=data, dlc=len(data), is_fd=len(data) > _BROKEN_BYTES,
            is_extended_id=bool(flags & FLAG_EXTENDED), is_error_frame=bool(flags & FLAG_ERROR),
        )  # fmt: skip
        return message, True

    def _take(self, chunk: Chunk) -> None:
        for packet, whole, after in self._deframer.feed(chunk.data):
            # What a converter hands over late and at once is not dated before what it handed over already.
            t_s = self._last_s = max(chunk.t_s - after * self._byte_s, min(self._last_s, chunk.t_s))
            if whole:
                number = self._framing.number(packet)
                self._ready.append((t_s, number, FLAG_EXTENDED * (number > 0x7FF), packet))
            else:
                self._ready.append((t_s, 0, FLAG_ERROR, packet[:_BROKEN_BYTES]))
