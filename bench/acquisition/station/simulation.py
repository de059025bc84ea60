"""The simulated equipment of a station file: its chamber, its units and its rate table, on the buses given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import can

from bench.acquisition.profile.orientation import latitude
from bench.acquisition.station.occasion import Occasion, eeprom_file, power_ons_file
from bench.acquisition.station.rate_table import simulate_table
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.simulated_instruments import SimulatedInstrument
from bench.acquisition.station.turning_axes import simulate_axes
from drivers.canbus import open_bus
from drivers.layout import Layout, layout_of
from drivers.registers import load_map
from drivers.sim.axes import Axes
from drivers.sim.can_gyro import CanGyro, is_family
from drivers.sim.can_unit import CanUnit, refuse_multiplexed
from drivers.sim.eeprom import Eeprom
from drivers.sim.flash_port import FlashPort
from drivers.sim.imu_correction import ImuCorrection
from drivers.sim.memory import CalibrationMemory
from drivers.sim.power_ons import PowerOns
from drivers.sim.resonator import PowerOn, Resonator, default_unit
from drivers.sim.resonator import UnitSettings as GyroPhysics
from drivers.sim.sender import Sender
from drivers.sim.station import Physics, SimulatedStation, SimulatedUnit


def simulate(
    settings: StationSettings,
    units: Sequence[UnitSettings],
    buses: Mapping[str, Bus],
    stack: ExitStack,
    occasion: Occasion | None = None,
    modbus_port: int = 0,
) -> SimulatedStation:
    """The simulated chamber and units of a station file, on these buses; `stack` closes the buses."""
    occasion = occasion or Occasion()
    seed, lasting = (settings.seeds(name)["run"] for name in (occasion.noise, occasion.name))
    plant = settings.plant(seed)
    simulated = []
    wires: dict[str, can.BusABC] = {}  # one connection a bus: one that only sends would collect what the others send
    for unit in units:
        if unit.bus not in wires:
            wires[unit.bus] = open_bus(buses[unit.bus].to_driver())
            stack.callback(wires[unit.bus].shutdown)
        if unit.serial in occasion.senders:
            interval_s = layout_of(unit.dbc, unit.mapping).interval_ms * 1e-3
            own = Sender(wires[unit.bus], occasion.senders[unit.serial], interval_s, room=buses[unit.bus].room)
            simulated.append(SimulatedUnit(own, own))
            continue
        if unit.signals is not None or not is_family(unit.gyro):
            simulated.append(
                _several_axes(settings, unit, (wires[unit.bus], buses[unit.bus].room), (seed, lasting), occasion)
            )
            continue
        physics = default_unit() if unit.simulation is None else GyroPhysics.parse(unit.simulation)
        wire = CanGyro(wires[unit.bus], unit.number, _identity(unit), layout=unit.gyro)
        wire.sample_s *= 1.0 + 1e-6 * physics.clock_ppm
        port = _port(settings, unit, wire)
        number, place = occasion.power_ons.get(unit.serial, 1), settings.units.index(unit)
        if occasion.start_s > 0.0:
            wire.go_on(round(occasion.start_s / wire.sample_s))
        power = PowerOn(number, occasion.start_s, lasting + place)
        counted = PowerOns(power_ons_file(settings, unit), number)
        simulated.append(SimulatedUnit(Resonator(physics, seed + place, power=power), wire, port, counted))
    table = simulate_table(settings, buses, stack, seed)
    fixture = simulate_axes(settings.fixture, buses, stack, seed)
    instruments = {one.name: SimulatedInstrument(one, plant) for one in settings.opened(occasion.switches_power)}
    return SimulatedStation(load_map(settings.chamber.map), plant, simulated, modbus_port, table, instruments, fixture)


def try_unit(settings: StationSettings, unit: UnitSettings) -> None:
    """ConfigError where the simulator cannot be this unit, which no sender stands for."""
    if unit.signals is None and is_family(unit.gyro):
        GyroPhysics.parse(unit.simulation or {})
        return
    layout = layout_of(unit.dbc, unit.mapping)
    refuse_multiplexed(layout)
    _physics(settings, layout, unit.simulation or {}, 0, PowerOn(1, 0.0, 0))


def _several_axes(
    settings: StationSettings,
    unit: UnitSettings,
    bus: tuple[can.BusABC, int],
    seeds: tuple[int, int],
    occasion: Occasion,
) -> SimulatedUnit:
    """A simulated unit whose signals the station file maps: inertial, or axes that know nothing of each other."""
    layout = layout_of(unit.dbc, unit.mapping)
    number, place = occasion.power_ons.get(unit.serial, 1), settings.units.index(unit)
    power = PowerOn(number, occasion.start_s, seeds[1] + 1000 * place)
    wire = CanUnit(bus[0], layout, unit.number, _identity(unit), room=bus[1])
    if occasion.start_s > 0.0:
        wire.go_on(round(occasion.start_s / wire.sample_s))
    seed, truth = seeds[0] + 1000 * place, unit.simulation or {}
    counted = PowerOns(power_ons_file(settings, unit), number)
    physics = _physics(settings, layout, truth, seed, power)
    # An image corrects six outputs together.
    whole = "imu" in truth and {*ImuCorrection.CHANNELS} <= layout.channels.keys()
    return SimulatedUnit(physics, wire, _port(settings, unit, wire) if whole else None, counted)


def _identity(unit: UnitSettings) -> int:
    return unit.identity or unit.number + 1


def _port(settings: StationSettings, unit: UnitSettings, wire: CanGyro | CanUnit) -> FlashPort:
    memory = CalibrationMemory(Eeprom(eeprom_file(settings, unit)), _identity(unit))
    return FlashPort(wire, memory, unit.flash.addresses(unit.number))


def _physics(settings: StationSettings, layout: Layout, truth: Mapping[str, Any], seed: int, power: PowerOn) -> Physics:
    if "imu" not in truth:
        return Axes(layout, truth, seed, power)
    from drivers.sim.inertial import InertialUnit  # loads scipy.signal, which other units do without

    return InertialUnit(layout, truth, seed, latitude(settings.orientation, None))
