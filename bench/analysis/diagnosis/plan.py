"""Profiles that could be run next: ramps and soaks within what the chamber can do, written as the bench's YAML.

A library of six kinds (minor loops, loops with rests, steps, another rate, long soaks, many reversals), its
temperatures and rates tuned to the range and the rates of this chamber. Set points never jump, so a prediction needs no
more of the chamber than its lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import fill

import numpy as np

from bench.base import CHANNELS, FloatArray, InputError
from bench.record import Dataset

_MOST_TIMES = 4
_UNSEEN_RATE = 0.5  # degC/min, of a direction that no run went
_ROUND = 20.0  # parts of a degC/min: what the thermometer adds to a rate is below
_STEADY_S = 600.0  # rates are taken from what the unit kept up for this long
_SETTLING_S = 780.0  # from room temperature to a settled start near it, with the dwell time of a profile that has none
_TURN_S = 8.0
"""What a chamber takes more where a ramp turns without a rest, by the square of the change of rate [(degC/min)^2].

Of the embedded simulator, a chamber of the TestEquity 107 class, whose rehearsals the library meets within 10 % up to
2 degC/min; at more it is too long.
"""


@dataclass(frozen=True)
class ChamberLimits:
    """Range [degC] and rates [degC/min] that a proposed profile keeps to, and its longest duration [min]."""

    lowest_degc: float
    highest_degc: float
    heating_degc_per_min: float
    cooling_degc_per_min: float
    budget_min: float = 480.0

    def __post_init__(self) -> None:
        if not self.lowest_degc < self.highest_degc or min(self.heating_degc_per_min, self.cooling_degc_per_min) <= 0:
            raise InputError(f"a chamber needs a range and rates above zero, not {self}")

    @property
    def rates(self) -> str:
        """Its rates in words."""
        heating, cooling = self.heating_degc_per_min, self.cooling_degc_per_min
        return f"it heats with up to {heating:g} and cools with up to {cooling:g} degC/min"

    def at(self, share: float) -> float:
        """Whole temperature [degC] at a share of the range."""
        return float(round(self.lowest_degc + share * (self.highest_degc - self.lowest_degc)))


@dataclass(frozen=True)
class Move:
    """A ramp [degC, degC/min] and a rest after it [min]."""

    to_degc: float
    rate_degc_per_min: float
    rest_min: float = 0.0


@dataclass(frozen=True)
class Plan:
    """A profile in the making: start temperature, then moves; `reason` says what its kind is good for."""

    name: str
    reason: str
    start_degc: float
    moves: tuple[Move, ...]
    settle_min: float = 10.0

    @property
    def duration_s(self) -> float:
        """Nominal duration from the settled start [s]."""
        return float(len(self.setpoint()) - 1)

    @property
    def expected_s(self) -> float:
        """Duration with the way to the start and the turns [s], for a chamber that keeps up the rates."""
        starts = (self.start_degc, *(move.to_degc for move in self.moves))
        rates = [np.sign(m.to_degc - at) * m.rate_degc_per_min for at, m in zip(starts, self.moves, strict=False)]
        pairs = zip(self.moves, rates, rates[1:], strict=False)
        turns = sum((after - rate) ** 2 for move, rate, after in pairs if rate * after < 0.0 and not move.rest_min)
        return float(self.duration_s + _SETTLING_S + _TURN_S * turns)

    def setpoint(self) -> FloatArray:
        """Set point [degC] of every second."""
        path = [np.full(round(60.0 * self.settle_min) + 1, self.start_degc)]
        at = self.start_degc
        for move in self.moves:
            seconds = round(60.0 * abs(move.to_degc - at) / move.rate_degc_per_min)
            path.append(np.linspace(at, move.to_degc, seconds + 1)[1:])
            path.append(np.full(round(60.0 * move.rest_min), move.to_degc))
            at = move.to_degc
        return np.concatenate(path)

    def to_yaml(self, limits: ChamberLimits, description: str) -> str:
        """The profile's file: what `bench run` reads."""
        text = fill(description, 110, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
        lines = [
            f"name: {self.name}",
            "description: >-",
            text,
            f"start: {{temperature_degc: {self.start_degc:g}, soak_min: {self.settle_min:g}}}",
            f"rates: {{heating_degc_per_min: {limits.heating_degc_per_min:g}, "
            f"cooling_degc_per_min: {limits.cooling_degc_per_min:g}}}",
            "segments:",
        ]
        at = self.start_degc
        for move in self.moves:
            if move.to_degc != at:
                lines.append(
                    f"  - {{kind: ramp, to_degc: {move.to_degc:g}, rate_degc_per_min: {move.rate_degc_per_min:g}}}"
                )
            if move.rest_min:
                lines.append(f"  - {{kind: soak, duration_min: {move.rest_min:g}}}")
            at = move.to_degc
        return "\n".join(lines) + "\n"


def chamber_limits(records: Sequence[Dataset]) -> ChamberLimits:
    """Limits from what the runs showed: their range, and the rates that the unit kept up for long.

    A faster chamber can be said with `limits`; one that cannot follow makes the ramp wait. `bench check` holds the
    profile against the station's own limits.
    """
    temperature = np.concatenate([record.channel("temperature") for record in records])
    low, high = float(np.ceil(np.nanmin(temperature))), float(np.floor(np.nanmax(temperature)))
    return ChamberLimits(low, high, *(rate or _UNSEEN_RATE for rate in kept_rates(records)))


def faster(limits: ChamberLimits) -> ChamberLimits:
    """Rates above those that runs showed, which most chambers reach; nearly every one heats faster than it cools."""
    heating, cooling = 2.0 * limits.heating_degc_per_min, 1.5 * limits.cooling_degc_per_min
    return replace(limits, heating_degc_per_min=round(heating, 1), cooling_degc_per_min=round(cooling, 1))


def kept_rates(records: Sequence[Dataset]) -> tuple[float, float]:
    """Fastest heating and cooling that a unit kept up for ten minutes, rounded to 0.05 [degC/min]."""
    rates = []
    for record in records:
        rows = max(1, round(_STEADY_S / record.interval_s))
        measured = record.channel("temperature")
        rates.append(60.0 * (measured[rows:] - measured[:-rows]) / (record.time[rows:] - record.time[:-rows]))
    slope = np.concatenate(rates)
    fastest = np.nanmax(slope, initial=0.0), -np.nanmin(slope, initial=0.0)
    return float(np.round(_ROUND * fastest[0]) / _ROUND), float(np.round(_ROUND * fastest[1]) / _ROUND)


_SHARES = (0.83, 0.54, 0.96, 0.37, 0.54, 0.08, 0.33, 0.21, 0.5)
_LOOPS = "soaks end effects that follow dT/dt, reversals show effects with memory"
_CYCLE = "another rate changes effects that follow dT/dt, and does not change a hysteresis"
_STEPS = "a soak after each step ends effects that follow dT/dt and leaves effects with memory"
_REVERSALS = "what lags behind the temperature shows at each reversal, and there are many, without rests"
_SOAKS = "in long soaks only effects that take hours continue"


def minor_loops(limits: ChamberLimits) -> Plan:
    """Reversals of many sizes over the whole range: the default for any rivals."""
    rests = (0.0, 0.0, 15.0, 0.0, 0.0, 15.0, 0.0, 0.0, 15.0)
    return _through(limits, ("minor_loops", _LOOPS), _SHARES, rests)


def isothermal_plan(limits: ChamberLimits) -> Plan:
    """Four hours at rest in the middle of the range, the first of them to settle."""
    return Plan("isothermal", "nothing moves but the noise", limits.at(0.5), (Move(limits.at(0.5), 1.0, 180.0),), 60.0)


def repetitions(plan: Plan, limits: ChamberLimits) -> list[Plan]:
    """A plan that ends where it began once, twice and so on, as often as the time budget allows."""
    several = [plan]
    while len(several) < _MOST_TIMES and plan.moves[-1].to_degc == plan.start_degc:
        times = len(several) + 1
        again = replace(plan, name=f"{plan.name}_{times}_times", moves=plan.moves * times)
        if again.expected_s > 60.0 * limits.budget_min:
            break
        several.append(again)
    return several


def plans(limits: ChamberLimits) -> list[Plan]:
    """The library, tuned to the chamber: all plans within the time budget, or the shortest if none is."""
    library = [
        minor_loops(limits),
        _through(limits, ("slow_minor_loops", _LOOPS), _SHARES, (15.0,), 0.6),
        _through(limits, ("large_loops_with_rests", _LOOPS), _back_and_forth(0.4, 0.2), (15.0,)),
        _through(
            limits, ("steps_of_a_fifth", _STEPS), (0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.08, 0.5), (25.0,)
        ),
        _through(limits, ("large_steps", _STEPS), (0.9, 0.3, 0.7, 0.1, 0.5), (25.0,)),
        _through(limits, ("fast_cycle", _CYCLE), (0.08, 1.0, 0.5), (15.0,)),
        _through(limits, ("slow_cycle", _CYCLE), (0.08, 1.0, 0.5), (15.0,), 0.5),
        _through(limits, ("long_soaks", _SOAKS), (1.0, 0.5), (120.0,)),
    ]
    for half in (0.1, 0.2):
        called = f"loops_of_{2 * half:.0%}_at_{limits.at(0.5):g}_degC".replace("%", "_percent")
        library.append(_through(limits, (called, _LOOPS), (*(0.5 + half, 0.5 - half) * 4, 0.5), (12.0,)))
    for forth, back in ((0.25, 0.125), (0.25, 0.16), (0.2, 0.13)):
        shares = _back_and_forth(forth, back)
        library.append(_through(limits, (f"{len(shares)}_reversals", _REVERSALS), shares, (0.0,)))
    for centre in (0.3, 0.5, 0.7):
        called = f"reversals_at_{limits.at(centre):g}_degC"
        library.append(_through(limits, (called, _REVERSALS), (*(centre + 0.08, centre - 0.08) * 16, 0.5), (0.0,)))
    affordable = [plan for plan in library if plan.expected_s <= 60.0 * limits.budget_min]
    return affordable or [min(library, key=lambda plan: plan.expected_s)]


def _back_and_forth(forth: float, back: float) -> tuple[float, ...]:
    """Shares of the range: from the middle to either end and to the middle, always so far forth and some of it back."""
    shares, at = [], 0.5
    for end, way in ((0.98, 1.0), (0.05, -1.0), (0.5, 1.0)):
        while way * (end - at) > forth:
            shares += [at + way * forth, at + way * (forth - back)]
            at = shares[-1]
        shares.append(at := end)
    return tuple(shares)


def _through(
    limits: ChamberLimits, called: tuple[str, str], shares: Sequence[float], rests: Sequence[float], speed: float = 1.0
) -> Plan:
    """A plan (name, reason) from mid-range through shares of the range; one rest for all moves, or one each."""
    moves, at = [], limits.at(0.5)
    for number, share in enumerate(shares):
        end = limits.at(share)
        fastest = limits.heating_degc_per_min if end > at else limits.cooling_degc_per_min
        moves.append(Move(end, round(speed * fastest, 2), rests[number % len(rests)]))
        at = end
    return Plan(*called, limits.at(0.5), tuple(moves))


_EXCITE = {
    "humidity": "let dry or moist air into the chamber at a constant temperature",
    "supply_current": "switch a load of the units on and off, every 10 minutes",
    "supply": "step the supply by a few percent, up and down, every 10 minutes",
    "drive": "change the amplitude set point of the drive by a few percent, up and down, every 10 minutes",
    "frequency": "change the drive (amplitude set point, phase) so that the frequency moves, every 10 minutes",
    "quadrature": "change the quadrature null (its trim or set point), up and down, every 10 minutes",
    "compressor": "let the compressor start and stop: switch the chamber off for 10 minutes at a time",
    "applied_rate": "turn the rate table in steps, both directions, every 10 minutes",
}


def exciting(limits: ChamberLimits, channels: Sequence[str], names: Sequence[str]) -> tuple[Plan, str]:
    """Rests at three temperatures while somebody moves the channels by hand, and what to do in words."""
    known = [channel for channel in channels if channel in _EXCITE]
    what = "; ".join(_EXCITE[channel] for channel in known)
    other = [c for c in channels if c not in _EXCITE]
    what = "; ".join(filter(None, [what, f"move {', '.join(other)} on purpose" if other else ""]))
    units = ", ".join(f"{c} [{CHANNELS[c].unit}]" if c in CHANNELS else c for c in channels)
    why = (
        f"{' and '.join(names)} differ in how they follow {units}, which the chamber does not change: during each "
        f"rest, {what}"
    )
    called = ("excite_channels", "channels moved at rest")
    return _through(limits, called, (0.5, 0.15, 0.85), (60.0,)), why
