"""A profile run only by simulated physics, without buses, frames or a journal: a hundred times faster.

Mysteries and the benchmark of the diagnosis need many runs and no equipment. The chamber is stepped once per second and
executes the legs by the rules of the sequencer; the unit is sampled at 10 Hz, which is enough for means over a second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.acquisition import Leg, Profile
from bench.base import EquipmentError, FloatArray, IntArray
from bench.record import ExecutedSegment
from drivers.sim.plant import Plant, PlantState
from drivers.sim.resonator import DIVIDER, Environment, PowerOn, Resonator, UnitSettings

RATE_HZ = 10.0
STEP_S = 5
"""Time over which chamber temperatures are interpolated linearly [s]; a multiple of DIVIDER / RATE_HZ."""


@dataclass(frozen=True, eq=False)
class Trace:
    """State of a chamber every second (n + 1,) from 0 to n, and the segments in the form of a manifest."""

    case: FloatArray
    air: FloatArray
    measured: FloatArray
    setpoint: FloatArray
    compressor: FloatArray
    heater: FloatArray
    segment: IntArray
    segments: tuple[ExecutedSegment, ...]

    @property
    def seconds(self) -> int:
        """Length of the record [s]."""
        return len(self.case) - 1


def chamber(profile: Profile, seed: int, plant: Plant | None = None) -> Trace:
    """Run a chamber through all legs of a profile, cut to whole steps; EquipmentError if a leg does not end."""
    plant = plant or Plant(seed=seed)
    states, index = [plant.state], [0]
    segments: list[ExecutedSegment] = []
    turn_on = 1
    for leg in profile.legs():
        begin = len(states) - 1
        _run_leg(leg, plant, states)
        index += [leg.index] * (len(states) - 1 - begin)
        turn_on += leg.kind == "power_cycle"
        segments.append(_segment(leg, begin, len(states) - 1).model_copy(update={"turn_on": turn_on}))
    whole = (len(states) - 1) // STEP_S * STEP_S + 1
    kept = states[:whole]

    def column(value: Callable[[PlantState], float]) -> FloatArray:
        return np.array([value(state) for state in kept], dtype=np.float64)

    return Trace(
        case=column(lambda s: s.case),
        air=column(lambda s: s.air),
        measured=column(lambda s: s.process_value),
        setpoint=column(lambda s: s.working_setpoint),
        compressor=column(lambda s: float(s.compressor)),
        heater=column(lambda s: s.heater),
        segment=np.array(index[1:whole], dtype=np.int64),
        segments=tuple(segments),
    )


def _run_leg(leg: Leg, plant: Plant, states: list[PlantState]) -> None:
    """Step the plant until the leg ends by the rules of the sequencer."""
    rate = leg.rate_degc_per_min if leg.kind == "ramp" else None
    for passed in range(1, int(leg.timeout_s) + 2):
        states.append(plant.step(1.0, leg.target_degc, ramp_degc_per_min=rate))
        if passed >= leg.duration_s and _ended(leg, states):
            return
    raise EquipmentError(f"the simulated chamber did not finish '{leg.name}' within {leg.timeout_s:.0f} s")


def _ended(leg: Leg, states: list[PlantState]) -> bool:
    now = states[-1]
    if leg.kind == "ramp":
        return now.working_setpoint == leg.target_degc and abs(now.air - leg.target_degc) <= leg.arrival_band_degc
    rule = leg.settle
    if rule is None:
        return True
    if abs(now.air - leg.target_degc) > rule.band_degc or abs(now.case - leg.target_degc) > rule.unit_band_degc:
        return False
    dwell = states[-int(rule.dwell_s) :]
    if len(dwell) < int(rule.dwell_s) or any(abs(s.air - leg.target_degc) > rule.band_degc for s in dwell):
        return False
    return abs(dwell[-1].case - dwell[0].case) / (len(dwell) / 60.0) <= rule.slope_degc_per_min


def _segment(leg: Leg, begin: int, end: int) -> ExecutedSegment:
    return ExecutedSegment(
        index=leg.index,
        name=leg.name,
        kind=leg.kind,
        from_s=float(begin),
        to_s=float(end),
        target_degc=leg.target_degc,
        rate_degc_per_min=leg.rate_degc_per_min,
        direction=leg.direction,
        settled=True,
        outcome="done",
    )


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a unit at 10 Hz (n,) by channel; slow channels are NaN between their samples."""

    time: FloatArray
    channels: dict[str, FloatArray]
    segment: IntArray


def unit(
    settings: UnitSettings,
    trace: Trace,
    seed: int,
    applied_rate_dps: FloatArray | None = None,
    power: PowerOn | None = None,
) -> Samples:
    """A unit in that chamber, powered on at the start; `applied_rate_dps` (seconds + 1,) is the table's true rate.

    In power cycles it has no power, and its channels no values.
    """
    resonator = Resonator(settings, seed, RATE_HZ, power)
    applied = np.zeros(trace.seconds + 1) if applied_rate_dps is None else applied_rate_dps
    edges = range(0, trace.seconds, STEP_S)
    cycles = [segment for segment in trace.segments if segment.kind == "power_cycle"]
    signals = [
        resonator.advance(
            replace(
                _environment(trace, applied, t0),
                powered=not any(cycle.from_s < t0 + STEP_S and t0 < cycle.to_s for cycle in cycles),
            )
        )
        for t0 in edges
    ]
    time = np.arange(int(trace.seconds * RATE_HZ)) / RATE_HZ
    nodes = np.arange(0, len(time), DIVIDER)
    channels = {"rate": np.concatenate([s.rate_dph for s in signals])}
    for name in ("temperature", "frequency", "drive", "quadrature"):
        channels[name] = _at(len(time), nodes, np.concatenate([getattr(s, name) for s in signals]))
    starts = np.arange(0, len(time), int(STEP_S * RATE_HZ))
    channels["supply"] = _at(len(time), starts, np.array([s.supply for s in signals]))
    seconds = (nodes / RATE_HZ).astype(np.int64)
    for name, values in (
        ("chamber_temperature", trace.measured),
        ("chamber_setpoint", trace.setpoint),
        ("compressor", trace.compressor[1:]),
    ):
        channels[name] = _at(len(time), nodes, values[seconds])
    if applied_rate_dps is not None:
        corners = np.arange(0, trace.seconds + 1, STEP_S)
        channels["applied_rate"] = np.interp(time, corners, applied[corners])
    for cycle in cycles:
        first, end = cycle.from_s // STEP_S * STEP_S, -(-cycle.to_s // STEP_S) * STEP_S
        for name in ("rate", "temperature", "frequency", "drive", "quadrature", "supply"):
            channels[name][(time >= first) & (time < end)] = np.nan
    return Samples(time, channels, trace.segment[np.floor(time).astype(np.int64)])


def _environment(trace: Trace, applied: FloatArray, t0: int) -> Environment:
    t1 = t0 + STEP_S
    return Environment(
        t0_s=float(t0),
        samples=int(STEP_S * RATE_HZ),
        rate_hz=RATE_HZ,
        fixture_temperature=(trace.case[t0], trace.case[t1]),
        air_temperature=(trace.air[t0], trace.air[t1]),
        compressor=float(trace.compressor[t0 + 1 : t1 + 1].mean()),
        heater=float(trace.heater[t0 + 1 : t1 + 1].mean()),
        applied_rate_dps=(applied[t0], applied[t1]),
    )


def _at(rows: int, where: IntArray, values: FloatArray) -> FloatArray:
    column = np.full(rows, np.nan)
    column[where] = values
    return column
