"""A Modbus gateway with faults, between a link and a healthy Modbus TCP server: injects named faults into answers.

To the link it is a Modbus TCP server, RTU frames over TCP (as serial gateways), or RTU frames on a pty (a serial line);
behind it is any Modbus TCP server. Faults are switched on and off while it runs; the same seed and the same requests
give the same faults. Delays are wall time, as on a wire.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import struct
import threading
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, replace
from typing import Any, Literal

from drivers.sim.faults.named import ON_MODBUS
from drivers.sim.ptys import raw

Front = Literal["tcp", "rtu+tcp", "rtu"]
Write = Callable[[bytes], Awaitable[None]]

_ONLY = {"transaction": ("tcp",), "echo": ("rtu+tcp", "rtu"), "close": ("tcp", "rtu+tcp"), "refuse": ("tcp", "rtu+tcp")}
_PIECES_S = 0.02
_WRITES = (5, 6, 15, 16)
"""Function codes whose answer repeats the first five bytes of the request."""


@dataclass(frozen=True)
class Fault:
    """A fault that is switched on; it affects a `share` of the answers, at most `times` of them."""

    name: str
    share: float = 1.0
    times: int | None = None
    seconds: float = 0.0
    code: int = 6


class ModbusProxy:
    """Serves `url`; forwards to the Modbus TCP server at `upstream`. Runs in a separate thread until `close()`.

    `counts` is how often each fault has occurred, `requests` the number of requests that arrived.
    """

    def __init__(self, upstream: tuple[str, int], front: Front = "tcp", seed: int = 1) -> None:
        self.counts: Counter[str] = Counter()
        self.requests = 0
        self.front = front
        self._upstream = upstream
        self._random = random.Random(seed)
        self._faults: tuple[Fault, ...] = ()
        self._frozen: dict[bytes, bytes] = {}
        self._master, slave = os.openpty() if front == "rtu" else (-1, -1)
        self._slave = slave  # kept open, or the line would hang up whenever the client closes it
        if front == "rtu":
            raw(slave)
        self.port = 0
        self._loop = asyncio.new_event_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self._thread = threading.Thread(target=self._loop.run_forever, name="modbus proxy", daemon=True)
        self._thread.start()
        self._call(self._listen())

    @property
    def url(self) -> str:
        """Address of the proxy for a ModbusLink."""
        return f"rtu://{os.ttyname(self._slave)}" if self.front == "rtu" else f"{self.front}://127.0.0.1:{self.port}"

    def inject(
        self, name: str, *, share: float = 1.0, times: int | None = None, seconds: float = 0.0, code: int = 6
    ) -> None:
        """Switch a fault on; of several drawn for one answer, the one that was switched on first applies."""
        if name not in ON_MODBUS or self.front not in _ONLY.get(name, (self.front,)):
            raise ValueError(f"fault {name!r} on {self.front}: must be one of {', '.join(ON_MODBUS)}")
        self._call(self._set((*self._faults, Fault(name, share, times, seconds, code))))

    def clear(self, name: str | None = None) -> None:
        """Switch this fault off, or all; a refused port is served again."""
        self._call(self._set(tuple(fault for fault in self._faults if name is not None and fault.name != name)))

    def close(self) -> None:
        """End all connections and the thread; a second call does nothing."""
        if not self._thread.is_alive():
            return
        self._call(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)

    # ---- in the thread ----------------------------------------------------------------------------------------------

    def _call(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(10.0)

    async def _set(self, faults: tuple[Fault, ...]) -> None:
        self._faults = faults
        names = {fault.name for fault in faults}
        if "stuck" not in names:
            self._frozen.clear()
        if "refuse" in names:
            await self._hang_up()
            self.counts["refuse"] += 1
        elif self._server is None and not (self.front == "rtu" and self._tasks):
            await self._listen()

    async def _listen(self) -> None:
        if self.front == "rtu":
            self._spawn(self._serve_pty())
        else:
            self._server = await asyncio.start_server(self._accepted, "127.0.0.1", self.port)
            self.port = self._server.sockets[0].getsockname()[1]

    async def _hang_up(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._spawn(self._serve_tcp(reader, writer))

    async def _serve_tcp(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async def write(data: bytes) -> None:
            writer.write(data)
            await writer.drain()

        try:
            await self._serve(reader, write)
        finally:
            writer.transport.abort()

    async def _serve_pty(self) -> None:
        async def write(data: bytes) -> None:
            os.write(self._master, data)

        reader = asyncio.StreamReader()
        pipe = os.fdopen(os.dup(self._master), "rb", 0)
        transport, _ = await self._loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), pipe)
        try:
            await self._serve(reader, write)
        finally:
            transport.close()

    async def _serve(self, reader: asyncio.StreamReader, write: Write) -> None:
        """Serve one client, one request at a time, as a gateway with one serial line."""
        behind: asyncio.StreamWriter | None = None
        with contextlib.suppress(OSError, EOFError):
            source, behind = await asyncio.open_connection(*self._upstream)
            try:
                while True:
                    request = await (_read_mbap(reader) if self.front == "tcp" else _read_rtu(reader))
                    self.requests += 1
                    if not await self._exchange(request, source, behind, write):
                        return
            finally:
                behind.transport.abort()

    async def _exchange(
        self, request: Frame, source: asyncio.StreamReader, behind: asyncio.StreamWriter, write: Write
    ) -> bool:
        """Forward one request and answer it, with a fault if one was drawn; False: hang up."""
        fault = self._strikes()
        if fault.name == "silence":
            return True
        if fault.name == "ignore" and request.pdu[0] in _WRITES:
            answer = replace(request, pdu=request.pdu[:5])
            await write(answer.mbap() if self.front == "tcp" else answer.rtu())
            return True
        behind.write(replace(request, transaction=1).mbap())
        answer = replace(await _read_mbap(source), transaction=request.transaction)
        wire = self._spoil(fault, request, answer)
        if fault.name == "delay":
            await asyncio.sleep(fault.seconds)
        if fault.name == "split":
            await write(wire[:4])
            await asyncio.sleep(fault.seconds or _PIECES_S)
            wire = wire[4:]
        await write(wire)
        return fault.name != "close"

    def _strikes(self) -> Fault:
        """The fault for this answer, if any; one draw for each that is switched on."""
        for fault in self._faults:
            if self._random.random() < fault.share and fault.times != 0:
                if fault.times is not None:
                    kept = replace(fault, times=fault.times - 1)
                    self._faults = tuple(kept if other is fault else other for other in self._faults)
                self.counts[fault.name] += 1
                return fault
        return Fault("none")

    def _spoil(self, fault: Fault, request: Frame, answer: Frame) -> bytes:
        """Bytes of the answer on the wire."""
        pdu = answer.pdu
        changed = {
            "transaction": lambda: replace(answer, transaction=answer.transaction ^ 1),
            "device": lambda: replace(answer, device=answer.device ^ 3),
            "function": lambda: replace(answer, pdu=bytes([pdu[0] ^ 7]) + pdu[1:]),  # 3 becomes 4
            "count": lambda: replace(answer, pdu=_one_less(pdu)),
            "exception": lambda: replace(answer, pdu=bytes([pdu[0] & 0x7F | 0x80, fault.code])),
            "stuck": lambda: replace(answer, pdu=self._freeze(request, pdu)),
        }
        frame = changed[fault.name]() if fault.name in changed else answer
        wire = frame.mbap() if self.front == "tcp" else frame.rtu()
        if fault.name == "drop":
            return b""
        if fault.name in ("truncate", "close"):
            return wire[: len(wire) // 2]
        if fault.name == "garble":
            at = 2 if self.front == "tcp" else self._random.randrange(1, len(wire))
            return wire[:at] + bytes([wire[at] ^ 1 << self._random.randrange(8)]) + wire[at + 1 :]
        return request.rtu() + wire if fault.name == "echo" else wire

    def _freeze(self, request: Frame, pdu: bytes) -> bytes:
        return self._frozen.setdefault(request.pdu, pdu) if request.pdu[0] in (3, 4) else pdu


@dataclass(frozen=True)
class Frame:
    """One request or answer."""

    device: int
    pdu: bytes
    transaction: int = 0

    def mbap(self) -> bytes:
        """Bytes with the header of Modbus TCP."""
        return struct.pack(">HHHB", self.transaction, 0, len(self.pdu) + 1, self.device) + self.pdu

    def rtu(self) -> bytes:
        """Bytes with the CRC of a serial line."""
        body = bytes([self.device]) + self.pdu
        return body + struct.pack("<H", crc16(body))


async def _read_mbap(reader: asyncio.StreamReader) -> Frame:
    transaction, _, length, device = struct.unpack(">HHHB", await reader.readexactly(7))
    return Frame(device, await reader.readexactly(length - 1), transaction)


async def _read_rtu(reader: asyncio.StreamReader) -> Frame:
    """The next request whose CRC is right; bytes before it are skipped."""
    data = b""
    while True:
        data += await reader.readexactly(8 - len(data) if len(data) < 8 else 1)
        length = 9 + data[6] if data[1] in (15, 16) else 8
        if len(data) < length:
            continue
        if crc16(data[: length - 2]) == struct.unpack("<H", data[length - 2 : length])[0]:
            return Frame(data[0], data[1 : length - 2])
        data = data[1:]


def _one_less(pdu: bytes) -> bytes:
    """A read answer without its last register; a write answer that echoes another count or value."""
    return bytes([pdu[0], pdu[1] - 2]) + pdu[2:-2] if pdu[0] in (3, 4) else pdu[:-1] + bytes([pdu[-1] ^ 1])


def crc16(data: bytes) -> int:
    """CRC of RTU frames (polynomial 0xA001, start 0xFFFF; Modbus over Serial Line 1.02, 6.2.2)."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc
