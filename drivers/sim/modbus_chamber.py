"""A chamber controller on the wire: a Modbus TCP server on 127.0.0.1 that serves any register map.

It has no physics and no clock. The plant takes the operator's wishes with `commands()` and puts its state into the
registers with `publish()`; between the two the registers keep their values, as a controller's do.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Iterable
from dataclasses import dataclass

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.errors import ConfigError, LimitError, LinkError
from drivers.registers import Register, RegisterMap, Value

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

_FUNCTION = ExcCodes.ILLEGAL_FUNCTION


@dataclass(frozen=True)
class ChamberCommands:
    """What the controller was told."""

    setpoint: float
    """Target [degC]."""
    on: bool
    ramp_rate_degc_per_min: float | None
    """Rate at which the working set point moves; None: it jumps."""


class ModbusChamber:
    """Simulated controller; listens from construction until `close()`. Usable as a context manager."""

    def __init__(
        self,
        registers: RegisterMap,
        *,
        port: int = 0,
        limits: tuple[float, float] = (-45.0, 130.0),
        temperature: float = 25.0,
        identity: str = "F4T1A1EAA1A1AAA",
        device_id: int = 1,
    ) -> None:
        """Serve `registers` on `port` (0: any free one), with the controller's own set point `limits` [degC].

        `identity` goes into the register of the first identify rule when that is a text. Raises LinkError when the
        port is taken.
        """
        self._map = registers
        self._lock = threading.Lock()
        self._words = [0] * (max(r.end for r in registers.registers.values()))
        self._owner = {address: r for r in registers.registers.values() for address in range(r.address, r.end)}
        self._codes = {r.read for r in registers.registers.values()}
        self._limits = limits
        self._boot(temperature, identity)
        self._port = port
        self._device_id = device_id
        self._error: Exception | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="modbus-chamber", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error:
            self._thread.join()
            raise LinkError(f"simulated chamber on 127.0.0.1:{port}: {self._error}")

    def __enter__(self) -> ModbusChamber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> int:
        """Port on 127.0.0.1."""
        return self._port

    @property
    def url(self) -> str:
        """Address for a ModbusLink."""
        return f"tcp://127.0.0.1:{self._port}"

    def close(self) -> None:
        """Close all connections and end the thread; a second call changes nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()

    def commands(self) -> ChamberCommands:
        """What the registers command now."""
        with self._lock:
            setpoint, mode = self._get("setpoint"), self._get(self._map.run.register)
            rate = self._ramp_rate()
        return ChamberCommands(float(setpoint), mode != self._map.run.off, rate)

    def publish(
        self,
        *,
        temperature: float,
        working_setpoint: float,
        power: float = 0.0,
        compressor: bool | None = None,
        on: bool | None = None,
        alarms: Iterable[str] = (),
    ) -> None:
        """Put the state of the plant into the registers.

        `power` [%], heating positive. `on` False: the plant switched itself off. `alarms`: names of alarm registers
        of the map that are active now. What the map has no register for is left out.
        """
        active = set(alarms)
        values: dict[str, Value] = {"temperature": temperature, "working_setpoint": working_setpoint, "power": power}
        if compressor is not None:
            values["compressor"] = "on" if compressor else "off"
        with self._lock:
            if on is not None:
                values[self._map.run.state] = self._get(self._map.run.register) if on else self._map.run.off
            for name, value in values.items():
                if name in self._map:
                    self._put(self._map[name], self._map[name].encode(value))
            for register in self._map.registers.values():
                if register.normal or register.alarming:
                    self._put(register, (_status(register, register.name in active),))
            if unknown := active - {r.name for r in self._map.registers.values() if r.normal or r.alarming}:
                raise ConfigError(f"no alarm register {', '.join(sorted(unknown))}")

    def set_words(self, name: str, words: Iterable[int]) -> None:
        """Put raw words into a register, for faults that no healthy controller shows."""
        with self._lock:
            self._put(self._map[name], tuple(words))

    # ---- registers; the lock is held by the caller ------------------------------------------------------------------

    def _get(self, name: str) -> Value:
        register = self._map[name]
        return register.decode(self._words[register.address : register.end])

    def _put(self, register: Register, words: tuple[int, ...]) -> None:
        self._words[register.address : register.end] = words

    def _ramp_rate(self) -> float | None:
        ramp = self._map.ramp
        if ramp is None or any(self._get(name) != value for name, value in ramp.on.items()):
            return None
        if ramp.off and all(self._get(name) == value for name, value in ramp.off.items()):
            return None
        return float(self._get(ramp.rate))

    def _boot(self, temperature: float, identity: str) -> None:
        """Registers of a controller that was just switched on: off, set point at the air's temperature."""
        for register in self._map.registers.values():
            if register.normal or register.alarming:
                self._put(register, (_status(register, False),))
            elif register.values:
                self._put(register, (next(iter(register.values.values())),))
            elif register.type != "ascii":
                self._put(register, register.encode(max(0.0, register.low or 0.0)))
        start: dict[str, Value] = {
            "temperature": temperature,
            "setpoint": temperature,
            "working_setpoint": temperature,
            "setpoint_low": self._limits[0],
            "setpoint_high": self._limits[1],
            self._map.run.register: self._map.run.off,
            self._map.run.state: self._map.run.off,
            **(self._map.ramp.off if self._map.ramp else {}),
        }
        text = next((r.register for r in self._map.identify if self._map[r.register].type == "ascii"), None)
        if text:
            start[text] = identity
        for name, value in start.items():
            if name in self._map:
                self._put(self._map[name], self._map[name].encode(value))

    # ---- the wire; in the server's thread ---------------------------------------------------------------------------

    async def _action(
        self, code: int, start: int, address: int, count: int, words: list[int], new: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        """Called by pymodbus for every request inside the served ranges. Must not wait (it would mix up answers)."""
        with self._lock:
            if new is not None:
                return self._write(code, address, [int(word) for word in new]) if code in (6, 16) else _FUNCTION
            if code not in self._codes and code not in (6, 16):
                return _FUNCTION
            words[address - start : address - start + count] = self._words[address : address + count]
        return None

    def _write(self, code: int, address: int, words: list[int]) -> ExcCodes | None:
        """Take a write of whole registers, or refuse all of it: 2 not writable, 3 value not accepted."""
        accepted: list[tuple[Register, tuple[int, ...]]] = []
        while words:
            register = self._owner.get(address)
            if register is None or register.write is None or register.address != address or len(words) < register.count:
                return ExcCodes.ILLEGAL_ADDRESS
            if code == 6 and register.count != 1:
                return ExcCodes.ILLEGAL_ADDRESS
            mine = tuple(words[: register.count])
            if not self._accepts(register, mine):
                return ExcCodes.ILLEGAL_VALUE
            accepted.append((register, mine))
            address, words = register.end, words[register.count :]
        for register, mine in accepted:
            self._put(register, mine)
            if register.name == self._map.run.register:
                state = self._map[self._map.run.state]
                self._put(state, state.encode(register.decode(mine)))
        return None

    def _accepts(self, register: Register, words: tuple[int, ...]) -> bool:
        try:
            value = register.decode(words)
            register.encode(value)
        except LimitError:
            return False
        if register.name == "setpoint":
            return self._limits[0] <= float(value) <= self._limits[1]
        return True

    def _ranges(self) -> list[SimData]:
        """Served addresses: every register, and the whole of the polled blocks with their holes."""
        spans = [(r.address, r.end) for r in self._map.registers.values()]
        spans += [(block[0].address, max(r.end for r in block)) for block in self._map.blocks]
        merged: list[list[int]] = []
        for low, high in sorted(spans):
            if merged and low <= merged[-1][1]:
                merged[-1][1] = max(high, merged[-1][1])
            else:
                merged.append([low, high])
        return [SimData(low, values=[0] * (high - low), datatype=DataType.REGISTERS) for low, high in merged]

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception as error:  # handed to the constructor, which raises it
            self._error = error
        self._ready.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        device = SimDevice(self._device_id, simdata=self._ranges(), action=self._action)
        server = ModbusTcpServer(device, address=("127.0.0.1", self._port), ignore_missing_devices=True)
        await server.serve_forever(background=True)
        listener = server.transport
        assert isinstance(listener, asyncio.Server)
        self._port = listener.sockets[0].getsockname()[1]
        self._ready.set()
        await self._stop.wait()
        await _turns()  # a connection on its way in gets in, or asyncio would leave its socket open
        await server.shutdown()  # type: ignore[no-untyped-call]
        await _turns()  # the closed transports let go of their sockets


async def _turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def _status(register: Register, active: bool) -> int:
    """Code of an alarm register that is, or is not, an alarm."""
    return next((code for name, code in register.values.items() if register.is_alarm(name) == active), 0)
