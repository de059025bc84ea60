"""A chamber controller on the wire: a Modbus server that serves any register map, over TCP or a serial line.

It has no physics and no clock. The plant reads the commands of the host with `commands()` and writes its state to the
registers with `publish()`; in between, the registers keep their values.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pymodbus.constants import ExcCodes

from drivers.errors import ConfigError, LimitError
from drivers.registers import Register, RegisterMap, Value
from drivers.sim.modbus_wire import ModbusWire


@dataclass(frozen=True)
class ChamberCommands:
    """Commands that the controller received."""

    setpoint: float
    """Target [degC]."""
    on: bool
    ramp_rate_degc_per_min: float | None
    """Rate at which the working set point moves; None: it jumps."""


class ModbusChamber:
    """Simulated controller; listens from construction until `close()`. Usable as a context manager."""

    def __init__(  # noqa: PLR0913 - each option has its default
        self,
        registers: RegisterMap,
        *,
        port: int = 0,
        limits: tuple[float, float] = (-45.0, 130.0),
        temperature: float = 25.0,
        device_id: int = 1,
        wire: str = "tcp",
        decimals: int = 1,
    ) -> None:
        """Serve `registers` on `port` (0: any free one), with the set point `limits` [degC] of the controller.

        It starts as a controller that satisfies every identify rule, with `decimals` implied decimals if the map
        has them. `wire` as in `ModbusWire`. Raises LinkError when the port is in use.
        """
        places = dict.fromkeys(registers.decimals, decimals)
        self._described = registers
        self._map = registers.with_decimals(places)
        self._lock = threading.Lock()
        everything = list(self._map.registers.values())
        size = 16 + max(register.end for register in everything)
        self._words = [0] * size
        both = {r.address + i for r in everything if r.read == 3 for i in range(r.count)} & {
            r.address + i for r in everything if r.read == 4 for i in range(r.count)
        }
        inputs = [0] * size if both else self._words  # one memory, as in most controllers, unless the map has two
        self._spaces = {1: [0] * size, 2: [0] * size, 3: self._words, 4: inputs}
        """Coils, discrete inputs, holding registers and input registers, by the function code that reads them."""
        self._writable = {
            (r.is_bit, address): r.name for r in everything if r.write for address in range(r.address, r.end)
        }
        self._codes = {register.read for register in everything}
        self._silent = {r.name: _status(r, False) for r in everything if r.normal or r.alarming}
        """Registers that can show an alarm, each with its code for no alarm."""
        self._limits = limits
        self._boot(temperature, places)
        bits = any(register.is_bit for register in everything)
        self._wire = ModbusWire(self._answer, self._spans(), bits=bits, wire=wire, port=port, device_id=device_id)

    def __enter__(self) -> ModbusChamber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> int:
        """Port on 127.0.0.1."""
        return self._wire.port

    @property
    def url(self) -> str:
        """Address for a ModbusLink."""
        return self._wire.url

    def close(self) -> None:
        """Close all connections and end the thread; a second call does nothing."""
        self._wire.close()

    def commands(self) -> ChamberCommands:
        """Current commands in the registers."""
        with self._lock:
            setpoint, mode = self._get("setpoint"), self._get(self._map.run.register)
            rate = self._ramp_rate()
        return ChamberCommands(float(setpoint), mode != self._map.run.off, rate)

    def publish(  # noqa: PLR0913 - the state of a plant is as wide as it is
        self,
        *,
        temperature: float,
        working_setpoint: float,
        power: float = 0.0,
        compressor: bool | None = None,
        on: bool | None = None,
        alarms: Iterable[str] = (),
        door: bool = False,
        sensor_break: bool = False,
    ) -> None:
        """Write the state of the plant to the registers.

        `power` [%], heating positive. `on` False: the plant switched itself off. `alarms`: names of active alarm
        registers of the map. Values without a register in the map are omitted, except a broken sensor: without a
        separate register it shows as an impossible temperature.
        """
        active = set(alarms)
        values: dict[str, Value] = {
            "temperature": temperature,
            "working_setpoint": working_setpoint,
            "power": power,
            "door": "open" if door else "closed",
            "sensor_break": "broken" if sensor_break else "ok",
        }
        if compressor is not None:
            values["compressor"] = "on" if compressor else "off"
        with self._lock:
            if on is not None:
                values[self._map.run.state] = self._get(self._map.run.register) if on else self._map.run.off
            for name, value in values.items():
                if name in self._map:
                    self._set(self._map[name], value)
            if sensor_break and "sensor_break" not in self._map:
                self._put(self._map["temperature"], self._map["temperature"].impossible)
            self._publish_alarms(active)

    def words(self, name: str) -> list[int]:
        """Raw words of a register."""
        with self._lock:
            return self._words_of(name)

    def set_words(self, name: str, words: Iterable[int]) -> None:
        """Write raw words to a register, for faults that a healthy controller does not show."""
        with self._lock:
            self._put(self._map[name], tuple(words))
            if name in self._described.decimals:
                self._map = self._described.with_decimals({n: self._words_of(n)[-1] for n in self._described.decimals})

    def set_value(self, name: str, value: Value) -> None:
        """Write a value to a register, as an operator at the panel would."""
        with self._lock:
            self._set(self._map[name], value)

    def restrict(self, highest: float) -> None:
        """Accept set points only up to `highest` [degC], as after a change of the limits at the panel."""
        with self._lock:
            self._limits = self._limits[0], highest
            if "setpoint_high" in self._map:
                self._set(self._map["setpoint_high"], highest)

    # ---- registers; the lock is held by the caller ------------------------------------------------------------------

    def _get(self, name: str) -> Value:
        return self._map[name].decode(self._words_of(name))

    def _words_of(self, name: str) -> list[int]:
        register = self._map[name]
        return self._spaces[register.read][register.address : register.end]

    def _set(self, register: Register, value: Value) -> None:
        if not isinstance(value, str) and register.type == "uint16":
            value = max(register.offset, value)  # cooling, in a register that only holds heating
        self._put(register, register.encode(value))

    def _put(self, register: Register, words: tuple[int, ...]) -> None:
        if register.mask is not None:
            held = self._spaces[register.read][register.address]
            words = (held & ~register.mask | words[0] & register.mask,)
        self._spaces[register.read][register.address : register.end] = words

    def _publish_alarms(self, active: set[str]) -> None:
        if unknown := active - self._silent.keys():
            raise ConfigError(f"no alarm register {', '.join(sorted(unknown))}")
        for name, silent in self._silent.items():
            if name in active:
                self._put(self._map[name], (_status(self._map[name], True),))
            elif name not in (self._map.run.register, self._map.run.state):
                self._put(self._map[name], (silent,))

    def _ramp_rate(self) -> float | None:
        ramp = self._map.ramp
        if ramp is None or any(self._get(name) != value for name, value in ramp.on.items()):
            return None
        if ramp.off and all(self._get(name) == value for name, value in ramp.off.items()):
            return None
        return float(self._get(ramp.rate))

    def _boot(self, temperature: float, decimals: Mapping[str, int]) -> None:
        """Set the registers of a controller after power-on: off, set point at the air temperature."""
        for register in self._map.registers.values():
            if register.normal or register.alarming:
                self._put(register, (_status(register, False),))
            elif register.values:
                self._put(register, (next(iter(register.values.values())),))
            elif register.type != "ascii":
                self._put(register, register.encode(min(max(0.0, register.low or 0.0), register.high or 0.0)))
        run = self._map.run
        start: dict[str, Value] = {
            **dict.fromkeys(("temperature", "setpoint", "working_setpoint", *self._map.setpoint_copies), temperature),
            "setpoint_low": self._limits[0],
            "setpoint_high": self._limits[1],
            **decimals,
            **{rule.register: rule.example_of(self._map[rule.register]) for rule in self._map.identify},
            **dict.fromkeys((run.register, run.state), run.off),
            **(self._map.ramp.off if self._map.ramp else {}),
        }
        for name, value in start.items():
            if name in self._map:
                self._put(self._map[name], self._map[name].encode(value))

    # ---- requests; in the server's thread ---------------------------------------------------------------------------

    def _answer(self, code: int, address: int, count: int, new: Sequence[int] | None) -> list[int] | ExcCodes:
        with self._lock:
            if new is not None:
                return self._write(code, address, list(new)) or []
            if code not in self._codes and code not in (5, 6, 16):  # pymodbus reads back what it has written
                return ExcCodes.ILLEGAL_FUNCTION
            if count > self._map.block_words:
                return ExcCodes.ILLEGAL_VALUE
            return self._spaces[{5: 1, 6: 3, 16: 3}.get(code, code)][address : address + count]

    def _write(self, code: int, address: int, words: list[int]) -> ExcCodes | None:
        """Execute a write of whole registers, or refuse all of it: 2 not writable, 3 value not accepted."""
        accepted: list[tuple[Register, tuple[int, ...]]] = []
        while words:
            name = self._writable.get((code == 5, address))
            if name is None:
                return ExcCodes.ILLEGAL_ADDRESS
            register = self._map[name]
            if register.address != address or len(words) < register.count:
                return ExcCodes.ILLEGAL_ADDRESS
            if code == 6 and register.count != 1:
                return ExcCodes.ILLEGAL_ADDRESS
            content = tuple(words[: register.count])
            if not self._accepts(register, content):
                return ExcCodes.ILLEGAL_VALUE
            accepted.append((register, content))
            address, words = register.end, words[register.count :]
        for register, content in accepted:
            self._spaces[register.read][register.address : register.end] = content
            if register.name == self._map.run.register:
                state = self._map[self._map.run.state]
                self._put(state, state.encode(register.decode(content)))
        return None

    def _accepts(self, register: Register, words: tuple[int, ...]) -> bool:
        try:
            value = register.decode(words)
            register.encode(value)
        except LimitError:
            return False
        if register.name in ("setpoint", *self._map.setpoint_copies):
            return self._limits[0] <= float(value) <= self._limits[1]
        return True

    def _spans(self) -> list[tuple[int, int]]:
        """Served addresses: every register, and the whole polled blocks with their gaps."""
        spans = [(r.address, r.end) for r in self._map.registers.values() if not r.is_bit]
        blocks = [block for block in self._map.blocks if not block[0].is_bit]
        return spans + [(block[0].address, max(r.end for r in block)) for block in blocks]


def _status(register: Register, active: bool) -> int:
    """Code of an alarm register with or without an active alarm."""
    named = next((code for name, code in register.values.items() if register.is_alarm(name) == active), None)
    if named is not None or not active:
        return named or 0
    bits = 0xFFFF if register.mask is None else register.mask
    return next(code for code in itertools.count(1) if code & bits == code and code not in register.values.values())
