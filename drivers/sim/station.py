"""The simulated station: chamber plant behind a Modbus server, gyros and a rate table on CAN buses, in lock-step.

A `SimClock` calls `advance(t0, t1)`: it reads commands from the chamber's registers, advances the plant and each gyro,
then updates the registers and sends the frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import can
import numpy as np

from drivers.registers import RegisterMap
from drivers.sim.cia402_table import SimulatedTable
from drivers.sim.fixture import SimulatedFixture
from drivers.sim.flash_port import FlashPort, serve
from drivers.sim.modbus_chamber import ModbusChamber
from drivers.sim.plant import Plant
from drivers.sim.power_ons import PowerOns
from drivers.sim.resonator import DIVIDER, Environment
from drivers.sim.truth.base import FloatArray

SAMPLE_RATE_HZ = 500


class Physics(Protocol):
    """What a unit measures."""

    def advance(self, environment: Environment) -> Any:
        """Signals of a piece of time."""


class Wire(Protocol):
    """What sends them."""

    bus: can.BusABC
    sample_s: float
    serial: int

    def send(self, t0_s: float, signals: Any, /) -> None:
        """Send the frames of signals from bench time `t0_s` [s] on."""

    def reboot(self) -> None:
        """Start anew."""


class Instrument(Protocol):
    """An instrument beside chamber and units."""

    settings: Any

    @property
    def address(self) -> str:
        """Where it listens."""

    @property
    def on(self) -> bool:
        """Whether its output is on."""

    def follow(self) -> None:
        """Take in the state of the plant."""

    def fail(self, fault: str, value: float | None, *, on: bool) -> None:
        """Begin or end a fault."""

    def close(self) -> None:
        """Stop its server."""


@dataclass
class SimulatedUnit:
    """One unit: its physics, its wire, and its calibration memory if it has one."""

    physics: Physics
    wire: Wire
    port: FlashPort | None = None
    power_ons: PowerOns = field(default_factory=PowerOns)
    _powered: bool = True
    _due_s: float | None = None
    _turned: tuple[FloatArray, FloatArray] | None = None

    def follow(self, environment: Environment, t1_s: float) -> None:
        """Advance as far as its own clock, which is not the station's, has samples up to `t1_s` [s]."""
        t0_s, sample_s = environment.t0_s, self.wire.sample_s
        due_s = t0_s if self._due_s is None else self._due_s
        samples = math.floor((t1_s - due_s) / (sample_s * DIVIDER) + 1e-6) * DIVIDER
        if samples <= 0:  # a step that is shorter than the unit's own
            self._due_s = due_s
            return
        self._due_s = due_s + samples * sample_s
        rates = np.asarray(environment.applied_rate_dps, dtype=np.float64)
        times = np.linspace(t0_s, t1_s, len(rates))
        before = (times[:1], rates[:1]) if self._turned is None else self._turned
        self._turned = times, rates
        known, values = (np.concatenate(pair) for pair in zip(before, (times, rates), strict=True))
        own = np.linspace(due_s, self._due_s, samples // DIVIDER + 1)
        self.advance(replace(environment, t0_s=due_s, samples=samples, applied_rate_dps=np.interp(own, known, values)))

    def advance(self, environment: Environment) -> None:
        """Advance by one step and send its signals; without power it sends none, and boots when that is back."""
        signals = self.physics.advance(environment)
        if not environment.powered:
            self._powered = False
            return
        if not self._powered:
            self._powered = True
            self.power_ons.next()
            if self.port is None:
                self.wire.reboot()
            else:
                self.port.power_up()
        if self.port is not None:
            signals, self.port.wire.status = self.port.memory.correct(signals)
        self.wire.send(environment.t0_s, signals)


class SimulatedStation:
    """A chamber and the units in it; the chamber listens on `modbus_port`."""

    def __init__(  # noqa: PLR0913, PLR0917 - what a station has
        self,
        register_map: RegisterMap,
        plant: Plant,
        units: Sequence[SimulatedUnit],
        modbus_port: int = 0,
        table: SimulatedTable | None = None,
        instruments: Mapping[str, Instrument] | None = None,
        fixture: SimulatedFixture | None = None,
    ) -> None:
        self.plant = plant
        self.table, self.instruments, self.fixture = table, dict(instruments or {}), fixture
        self.units = list(units)
        self.chamber = ModbusChamber(
            register_map, limits=plant.parameters.reach, port=modbus_port, temperature=plant.state.process_value
        )
        self.shown: dict[str, Any] = {}
        """Values that the controller shows instead of the true ones, as arguments of `ModbusChamber.publish`."""
        self._attitude, self._visit = np.eye(3), 0
        self._samples_due = 0.0
        self._publish()

    @property
    def modbus_port(self) -> int:
        """TCP port of the chamber on 127.0.0.1."""
        return self.chamber.port

    def turn(self, attitude: FloatArray) -> None:
        """Turn the fixture with the units to an attitude (3, 3), from the table's frame to that of the units."""
        self._attitude, self._visit = attitude, self._visit + 1

    def advance(self, t0_s: float, t1_s: float) -> None:
        """Advance the simulation from `t0_s` to `t1_s` [s]."""
        powered = all(one.on for one in self.instruments.values() if one.settings.powers_units)
        serve([unit.port for unit in self.units if unit.port is not None and powered], t0_s)
        commands = self.chamber.commands()
        before = self.plant.state
        ramp = commands.ramp_rate_degc_per_min
        after = self.plant.step(t1_s - t0_s, commands.setpoint, on=commands.on, ramp_degc_per_min=ramp)
        self._publish()
        if self.fixture is not None:
            self.fixture.advance(t0_s, t1_s)
            self._attitude, self._visit = self.fixture.attitude, self.fixture.visit
        for instrument in self.instruments.values():
            instrument.follow()
        turned = (0.0, 0.0) if self.table is None else self.table.advance(t0_s, t1_s)
        self._samples_due += (t1_s - t0_s) * SAMPLE_RATE_HZ
        samples = int(self._samples_due + 1e-6)
        self._samples_due -= samples
        if samples:
            environment = Environment(
                t0_s=t0_s,
                samples=samples,
                rate_hz=SAMPLE_RATE_HZ,
                fixture_temperature=(before.case, after.case),
                air_temperature=(before.air, after.air),
                compressor=float(after.compressor),
                applied_rate_dps=turned,
                powered=powered,
                attitude=self._attitude,
                visit=self._visit,
            )
            for unit in self.units:
                if unit.wire.sample_s * SAMPLE_RATE_HZ == 1.0:
                    unit.advance(environment)
                else:
                    unit.follow(environment, t1_s)

    def _publish(self) -> None:
        state = self.plant.state
        truth = {
            "temperature": state.process_value,
            "working_setpoint": state.working_setpoint,
            "power": 100.0 * state.power,
            "on": state.on,
            "compressor": state.compressor,
        }
        self.chamber.publish(**truth | self.shown)

    def close(self) -> None:
        """Stop the Modbus server; the caller closes the buses."""
        self.chamber.close()
        if self.table is not None:
            self.table.close()
        if self.fixture is not None:
            self.fixture.close()
        for instrument in self.instruments.values():
            instrument.close()
