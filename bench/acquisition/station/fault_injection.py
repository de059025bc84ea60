"""A simulated station that fails by the clock: the faults of its station file, switched on and off as time passes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import Any

import can

from bench.acquisition.station.records import Journal
from bench.acquisition.station.settings.faults import CHAMBER, REPLACED, WIRE, FaultSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from drivers.registers import RegisterMap
from drivers.sim.faults.bus import FaultyBus
from drivers.sim.faults.proxy import ModbusProxy
from drivers.sim.station import SimulatedStation, SimulatedUnit

TIMEOUT_S = 0.25
"""A chamber behind a faulty wire is waited for so long [s of wall time]; bench time stands still meanwhile."""


class FaultInjection:
    """The faults of one simulated run; `advance` takes the place of that of the simulated station."""

    def __init__(
        self,
        settings: StationSettings,
        units: Sequence[UnitSettings],
        simulation: SimulatedStation,
        registers: RegisterMap,
        stack: ExitStack,
        journal: Journal,
    ) -> None:
        """`stack` closes what stands between bench and equipment; `journal` is told when a fault begins and ends."""
        self._journal = journal
        self.wires: dict[str, FaultyBus] = {}
        """Faulty wires, by the name of a bus or the serial number of a unit."""
        self.proxy: ModbusProxy | None = None
        """The faulty wire of the chamber."""
        self._simulation, self._registers, self._stack = simulation, registers, stack
        self._ambient_degc, self._seed = settings.ambient_degc, settings.seed
        self._units: dict[str, SimulatedUnit] = {}
        idle = {unit.serial for unit in settings.units} - {unit.serial for unit in units}
        idle |= {one.name for one in settings.instruments} - simulation.instruments.keys()
        faults = [fault for fault in settings.faults if fault.on not in idle]
        self.where = frozenset(fault.on for fault in faults)
        """What fails: `chamber`, names of buses and instruments, serial numbers."""
        if any(fault.on == CHAMBER and fault.fault in (*WIRE, "restart") for fault in faults):
            self.proxy = stack.enter_context(
                closing(ModbusProxy(("127.0.0.1", simulation.modbus_port), seed=self._seed))
            )
        for unit, simulated in zip(units, simulation.units, strict=True):
            if unit.serial in self.where:
                self._units[unit.serial] = simulated
                simulated.wire.bus = self.around(unit.serial, simulated.wire.bus, unit)
        changes = [(fault.at_s, True, fault) for fault in faults]
        changes += [(fault.at_s + fault.for_s, False, fault) for fault in faults if fault.for_s is not None]
        self._due = sorted(changes, key=lambda change: change[:2])

    def around(self, name: str, bus: can.BusABC, unit: UnitSettings) -> FaultyBus:
        """The same bus with what goes wrong on it."""
        wire = FaultyBus(bus, seed=self._seed + len(self.wires), layout=unit.gyro, number=unit.number)
        self._stack.callback(wire.shutdown)
        self.wires[name] = wire
        return wire

    def advance(self, t0_s: float, t1_s: float) -> None:
        """Let the simulated world pass from `t0_s` to `t1_s` [s] with the faults that are on at `t0_s`."""
        while self._due and self._due[0][0] <= t0_s:
            _, begins, fault = self._due.pop(0)
            before = self._struck(fault)
            self._switch(fault, on=begins)
            text = f"{fault} begins" if begins else f"{fault} ends"
            self._journal.event("rehearsal", text, fault=fault.fault, on=fault.on, begins=begins, struck=before)
        self._simulation.advance(t0_s, t1_s)

    def _struck(self, fault: FaultSettings) -> int:
        """How many answers or frames this fault has struck at this place so far; nobody counts those of instruments."""
        if fault.on in self._simulation.instruments:
            return 0
        if fault.on == CHAMBER:
            return 0 if self.proxy is None else self.proxy.counts[fault.fault]
        return self.wires[fault.on].counts[fault.fault]

    def _switch(self, fault: FaultSettings, *, on: bool) -> None:
        if fault.on == CHAMBER:
            self._switch_chamber(fault, on=on)
        elif fault.on in self._simulation.instruments:
            self._simulation.instruments[fault.on].fail(fault.fault, fault.value, on=on)
        elif fault.fault == REPLACED:
            if on:
                wire = self._units[fault.on].wire
                wire.serial = round(fault.value or 0)
                wire.reboot()
        elif on:
            self.wires[fault.on].inject(fault.fault, share=fault.share, seconds=fault.seconds)
        else:
            self.wires[fault.on].clear(fault.fault)

    def _switch_chamber(self, fault: FaultSettings, *, on: bool) -> None:
        if self.proxy is not None and fault.fault in (*WIRE, "restart"):
            wire = "refuse" if fault.fault == "restart" else fault.fault
            options: dict[str, Any] = {"times": fault.times, "seconds": fault.seconds, "code": fault.code}
            (self.proxy.inject(wire, share=fault.share, **options) if on else self.proxy.clear(wire))
        if fault.fault in ("alarm", "door", "sensor_break", "frozen"):
            self._show(fault.fault, on=on)
        elif on:
            self._operate(fault)

    def _show(self, name: str, *, on: bool) -> None:
        """What the controller says of itself and its sensors."""
        alarm = next((r.name for r in self._registers.registers.values() if r.normal or r.alarming), "alarm")
        shown: dict[str, tuple[str, Any]] = {
            "alarm": ("alarms", [alarm]),
            "frozen": ("temperature", self._simulation.plant.state.process_value),
        }
        key, value = shown.get(name, (name, True))
        if on:
            self._simulation.shown[key] = value
        else:
            self._simulation.shown.pop(key, None)

    def _operate(self, fault: FaultSettings) -> None:
        """What somebody does at the panel, or a power cut."""
        chamber, registers = self._simulation.chamber, self._registers
        run = registers.run
        if fault.fault in ("setpoint", "restart"):
            target = self._ambient_degc if fault.value is None else fault.value
            for name in ("setpoint", *registers.setpoint_copies):
                chamber.set_value(name, target)
        if fault.fault in ("off", "restart"):
            for name in (run.register, run.state):
                chamber.set_value(name, run.off)
        if fault.fault == "limits" and fault.value is not None:
            chamber.restrict(fault.value)
