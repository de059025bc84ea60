"""A Modbus server of pymodbus in a separate thread: Modbus TCP, RTU frames over TCP, or RTU on a serial line.

It is independent of register maps: one function handles all reads and writes.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Literal
from urllib.parse import parse_qsl, urlsplit

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simutils import SimUtils

from drivers.errors import LinkError
from drivers.sim.ptys import PtyPair

if TYPE_CHECKING:
    from pymodbus.server import ModbusSerialServer, ModbusTcpServer

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

Wire = Literal["tcp", "rtu+tcp", "rtu"]
Answer = Callable[[int, int, int, "Sequence[int] | None"], "list[int] | ExcCodes"]
"""(function code, address, count, words to write or None) to the words read ([] for a write), or an exception."""

_SERVED, _OF_BITS = {3, 4, 6, 16}, {1, 2, 5}
_MOST_BITS = 1 << 16


class ModbusWire:
    """Listens from construction until `close()`. `answer` runs in the server's thread and must return quickly."""

    def __init__(
        self,
        answer: Answer,
        spans: Sequence[tuple[int, int]],
        *,
        bits: bool = False,
        wire: str = "tcp",
        port: int = 0,
        device_id: int = 1,
    ) -> None:
        """Serve the addresses `spans` (first, one after the last); all others get exception 2.

        With `bits` coils and discrete inputs are served, too; one that nobody described reads 0.

        `wire`: `tcp` or `rtu+tcp` on `port` of 127.0.0.1 (0: any free one), `rtu` on a new pseudo terminal, or
        `rtu:///dev/ttyUSB0?baudrate=9600` on a serial port. Raises LinkError when it cannot listen.
        """
        self._answer, self._spans, self._bits = answer, _merged(spans), bits
        self._wire, self.port, self._device_id = wire, port, device_id
        self.url = ""
        self._owned = ExitStack()
        self._error: Exception | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="modbus-chamber", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error:
            self._thread.join()
            where = f"127.0.0.1:{port}" if "tcp" in wire else wire
            raise LinkError(f"simulated chamber on {where}: {self._error}")

    def close(self) -> None:
        """Close all connections and end the thread; a second call does nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()

    def _run(self) -> None:
        try:
            with self._owned:
                asyncio.run(self._serve())
        except Exception as error:  # handed to the constructor, which raises it
            self._error = error
        self._ready.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        every = (self._flags(), self._flags(), self._registers(), self._registers())
        simdata = every if self._bits else self._registers()
        server = self._server(SimDevice(self._device_id, simdata=simdata, action=self._action))
        await server.serve_forever(background=True)
        listener = server.transport
        if isinstance(listener, asyncio.Server):
            self.port = listener.sockets[0].getsockname()[1]
            self.url = f"{self._wire}://127.0.0.1:{self.port}"
        self._ready.set()
        await self._stop.wait()
        await _turns()  # accept pending connections, or asyncio would leave their sockets open
        await server.shutdown()  # type: ignore[no-untyped-call]
        await _turns()  # let the closed transports close their sockets

    def _registers(self) -> list[SimData]:
        return [SimData(low, values=[0] * (high - low), datatype=DataType.REGISTERS) for low, high in self._spans]

    def _flags(self) -> list[SimData]:
        return [SimData(0, values=[False] * _MOST_BITS, datatype=DataType.BITS)]

    def _server(self, device: SimDevice) -> ModbusTcpServer | ModbusSerialServer:
        from pymodbus.server import ModbusSerialServer, ModbusTcpServer  # imports a whole web server

        if self._wire in ("tcp", "rtu+tcp"):
            framer = FramerType.SOCKET if self._wire == "tcp" else FramerType.RTU
            address = ("127.0.0.1", self.port)
            return ModbusTcpServer(device, framer=framer, address=address, ignore_missing_devices=True)
        if self._wire == "rtu":
            pair = self._owned.enter_context(closing(PtyPair()))
            self.url = f"rtu://{pair.left}?baudrate=19200"
            return ModbusSerialServer(device, port=pair.right, baudrate=19200, ignore_missing_devices=True)
        parts = urlsplit(self._wire)
        baudrate = int(dict(parse_qsl(parts.query)).get("baudrate", 19200))
        self.url = self._wire
        return ModbusSerialServer(device, port=parts.path, baudrate=baudrate, ignore_missing_devices=True)

    async def _action(
        self, code: int, start: int, address: int, count: int, words: list[int], new: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        """Called by pymodbus for every request inside the served ranges. Must not wait (it would mix up answers)."""
        if code in _OF_BITS and self._bits:
            return self._bit_action(code, address, count, words, new)
        if code not in _SERVED:
            return ExcCodes.ILLEGAL_FUNCTION
        answer = self._answer(code, address, count, None if new is None else [int(word) for word in new])
        if isinstance(answer, ExcCodes):
            return answer
        if new is None:
            words[address - start : address - start + count] = answer
        return None

    def _bit_action(
        self, code: int, address: int, count: int, words: list[int], new: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        """The same for bits: `address` is that of the first one, `count` the number of words of 16 with all of them."""
        first = address // 16
        start = address if new else 16 * first
        answer = self._answer(code, start, 16 * count, [int(bit) for bit in new] if new else None)
        if isinstance(answer, ExcCodes):
            return answer
        if not new:
            known = [*answer, *[0] * (16 * count - len(answer))]
            words[first : first + count] = SimUtils.bitsToRegisters([bool(bit) for bit in known])
        return None


def _merged(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Spans that overlap or touch, as one."""
    found: list[tuple[int, int]] = []
    for low, high in sorted(spans):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(high, found[-1][1])
        else:
            found.append((low, high))
    return found


async def _turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)
