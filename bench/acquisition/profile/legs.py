"""Legs: what the sequencer executes, made of the segments of a profile one after the other."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from bench.acquisition.profile.segments import (
    PowerCycle,
    Ramp,
    RateSteps,
    Repeat,
    Segment,
    SettleChange,
    SettleRule,
    Simple,
    Soak,
    Step,
    Tumble,
    names_of,
)
from bench.base import Place, PlacedError

if TYPE_CHECKING:
    from bench.acquisition.profile.profile import Profile

AMBIENT_DEGC = 23.0
"""Where the chamber is taken to stand before the first leg, for nominal times [degC]."""

STEP_DEGC_PER_MIN = 3.0
"""Nominal speed of a chamber that is told to jump [degC/min]; only predicted durations depend on it."""

UNIT_TAU_MIN = 8.0
"""Nominal time constant of a unit in its fixture [min]; only predicted durations depend on it."""

ACCEL_DPS2 = 20.0
"""Nominal acceleration of a rate table [deg/s^2]; only predicted durations depend on it."""

_MAX_LEGS = 2000
_LATEST_TURN_S = 300.0
_BOOT_S = 4.0
"""Nominal time until a unit that was switched on is heard; only predicted durations depend on it."""
_LATEST_BOOT_S = 120.0

Kind = Literal["ramp", "soak", "step", "rate", "power_cycle"]


@dataclass(frozen=True)
class Leg:
    """One thing to do with the chamber, as the sequencer executes it."""

    index: int
    name: str
    kind: Kind
    from_degc: float
    """Nominal: where the leg before ended."""
    target_degc: float
    timeout_s: float
    """A leg older than this has failed."""
    nominal_start_s: float
    """Expected start since the start of the profile."""
    nominal_s: float
    """Expected duration."""
    rate_degc_per_min: float | None = None
    """None: the set point jumps or stands."""
    duration_s: float = 0.0
    """Shortest duration; a step has none, it ends when settled; of a power cycle the time without power."""
    least_s: float = 0.0
    """Shortest duration of a ramp, which otherwise ends when the chamber has arrived."""
    settle: SettleRule | None = None
    """None: need not settle."""
    move_s: float = 0.0
    """Nominal time in which the set point moves."""
    arrival_band_degc: float = 1.0
    turn_dps: float = 0.0
    """Rate of the rate table [deg/s]; `duration_s` of a rate counts from when the table has got there."""
    attitude: str | None = None
    """Name of the attitude that the unit stands in; None: whatever it stands in."""
    line: int | None = None
    """Line in the profile's file."""

    @property
    def nominal_end_s(self) -> float:
        """Expected end [s] since the start of the profile."""
        return self.nominal_start_s + self.nominal_s

    @property
    def direction(self) -> Literal["heating", "cooling", "constant"]:
        """Where the temperature goes, nominally."""
        if self.target_degc == self.from_degc:
            return "constant"
        return "heating" if self.target_degc > self.from_degc else "cooling"


class LegBuilder:
    """Segments to legs, one after the other."""

    def __init__(self, profile: Profile, lines: Callable[[Place], int | None] = lambda place: None) -> None:
        self._profile, self._lines = profile, lines
        self._legs: list[Leg] = []
        self._names: Counter[str] = Counter()
        self._degc = AMBIENT_DEGC
        self._turn_dps = 0.0
        self._attitude: str | None = None
        self._place: Place = ()

    def legs(self) -> tuple[Leg, ...]:
        """All of them; ValueError with the place of what is not possible."""
        start = self._profile.start
        if start is not None:
            self._place, self._attitude = ("start",), start.attitude
            self._settle("start", start.temperature_degc, self._profile.settle)
            if start.soak_min > 0:
                self._stay("start soak", start.soak_min)
        for place, segment in _walk(self._profile.segments, ("segments",)):
            self._place = place
            self._turn_dps = 0.0
            if not isinstance(segment, RateSteps | Tumble | PowerCycle):
                self._turn_dps, self._attitude = segment.turn_dps, segment.attitude or self._attitude
            self._one(segment)
            if len(self._legs) > _MAX_LEGS:
                raise PlacedError(f"makes more than {_MAX_LEGS} legs; repeat less", self._place)
        return tuple(self._legs)

    def _one(self, segment: Simple) -> None:
        if isinstance(segment, Ramp):
            self._ramp(segment)
        elif isinstance(segment, Soak):
            self._soak(segment)
        elif isinstance(segment, RateSteps):
            self._rates(segment)
        elif isinstance(segment, Tumble):
            self._tumble(segment)
        elif isinstance(segment, PowerCycle):
            self._power(segment)
        else:
            self._step(segment)

    def _ramp(self, ramp: Ramp, least_s: float = 0.0) -> None:
        rate = self._rate(ramp)
        move_s = 60.0 * abs(ramp.to_degc - self._degc) / rate
        self._add(
            ramp.name or f"ramp to {ramp.to_degc:g} at {rate:g}",
            "ramp",
            ramp.to_degc,
            rate_degc_per_min=rate,
            duration_s=move_s,
            nominal_s=move_s,
            move_s=move_s,
            timeout_s=move_s + 60.0 * ramp.timeout_min,
            arrival_band_degc=ramp.arrival_band_degc,
            least_s=least_s,
        )

    def _rate(self, ramp: Ramp) -> float:
        heating = ramp.to_degc > self._degc
        rates, direction = self._profile.rates, "heating" if heating else "cooling"
        limit = None if rates is None else rates.heating_degc_per_min if heating else rates.cooling_degc_per_min
        if ramp.rate_degc_per_min is None and limit is None:
            raise PlacedError("a ramp needs rate_degc_per_min, here or in the profile's `rates`", self._place)
        rate = ramp.rate_degc_per_min or limit or 0.0
        if limit is not None and rate > limit:
            text = f"rate_degc_per_min is {rate:g}, but `rates` limits {direction} to {limit:g}; lower the one or raise"
            raise PlacedError(f"{text} the other", (*self._place, "rate_degc_per_min"))
        return rate

    def _soak(self, soak: Soak) -> None:
        settle = self._rule(soak.settle) if soak.until == "settled" else None
        self._stay(soak.name or f"soak at {self._degc:g}", soak.duration_min or 0.0, settle)

    def _step(self, step: Step) -> None:
        for i, target in enumerate(step.temperatures_degc):
            self._settle(f"{step.name or 'step'} to {target:g}", target, self._rule(step.settle), i)
            self._stay(f"{step.name or 'step'} at {target:g}", step.average_min)

    def _rates(self, turning: RateSteps) -> None:
        for i, target in enumerate(turning.temperatures_degc or (None,)):
            self._turn_dps = 0.0
            if target is not None:
                self._settle(f"{turning.name or 'rates'}: to {target:g}", target, self._rule(turning.settle), i)
            for attitude in (self._attitude,) if turning.attitudes is None else names_of(turning.attitudes):
                self._turn_dps, self._attitude = 0.0, attitude
                self._turn(turning)

    def _turn(self, turning: RateSteps) -> None:
        for turn in turning.turns():
            reach_s = abs(turn - self._turn_dps) / ACCEL_DPS2
            self._turn_dps = turn
            self._add(
                f"{turning.name or 'rate'} {f'{turn:+g}' if turn else '0'} deg/s at {self._degc:g}",
                "rate",
                self._degc,
                duration_s=turning.dwell_s,
                nominal_s=reach_s + turning.dwell_s,
                timeout_s=reach_s + turning.dwell_s + _LATEST_TURN_S,
            )

    def _tumble(self, tumble: Tumble) -> None:
        names = names_of(tumble.attitudes)
        start, end = self._degc, tumble.to_degc
        for i, attitude in enumerate(names, 1):
            self._attitude = attitude
            name = f"{tumble.name or 'tumble'}: {attitude}"
            if end is None or end == start:
                self._stay(name, tumble.dwell_min)
                continue
            part, speed = start + (end - start) * i / len(names), abs(end - start) / (len(names) * tumble.dwell_min)
            ramp = Ramp(kind="ramp", name=name, to_degc=round(part, 3), rate_degc_per_min=speed)
            self._ramp(ramp, 60.0 * tumble.dwell_min)

    def _power(self, cycle: PowerCycle) -> None:
        name, off_s = cycle.name or f"power cycle at {self._degc:g}", 60.0 * cycle.off_min
        nominal_s = off_s + _BOOT_S
        self._add(
            name, "power_cycle", self._degc, duration_s=off_s, nominal_s=nominal_s, timeout_s=nominal_s + _LATEST_BOOT_S
        )
        self._stay(f"{name}: settle", cycle.on_min, self._rule(cycle.settle))

    def _settle(self, name: str, target_degc: float, rule: SettleRule, item: int | None = None) -> None:
        move_s = 60.0 * abs(target_degc - self._degc) / STEP_DEGC_PER_MIN
        place = self._place if item is None else (*self._place, "temperatures_degc", item)
        timeout_s = move_s + 60.0 * rule.timeout_min
        self._add(name, "step", target_degc, settle=rule, move_s=move_s, timeout_s=timeout_s,
                  nominal_s=move_s + _settling_s(move_s, rule), line=self._lines(place))  # fmt: skip

    def _stay(self, name: str, minutes: float, rule: SettleRule | None = None) -> None:
        duration_s = 60.0 * minutes
        longest_s = duration_s if rule is None else max(duration_s, rule.dwell_s)
        timeout_s = longest_s + (60.0 if rule is None else 60.0 * rule.timeout_min)
        self._add(
            name, "soak", self._degc, settle=rule, duration_s=duration_s, nominal_s=longest_s, timeout_s=timeout_s
        )

    def _rule(self, own: SettleChange | None) -> SettleRule:
        return self._profile.settle.model_copy(update={} if own is None else own.model_dump(exclude_none=True))

    def _add(self, name: str, kind: Kind, target_degc: float, **values: Any) -> None:
        self._names[name] += 1
        leg = Leg(
            index=len(self._legs),
            name=name if self._names[name] == 1 else f"{name} ({self._names[name]})",
            kind=kind,
            from_degc=self._degc,
            target_degc=target_degc,
            nominal_start_s=self._legs[-1].nominal_end_s if self._legs else 0.0,
            turn_dps=self._turn_dps,
            attitude=self._attitude,
            **{"line": self._lines(self._place), **values},
        )
        self._legs.append(leg)
        self._degc = target_degc


def _settling_s(move_s: float, rule: SettleRule) -> float:
    """Expected time [s] until a first-order unit that lags behind the air is slow enough, dwell included."""
    tau_s = 60.0 * UNIT_TAU_MIN
    slope = STEP_DEGC_PER_MIN * (1.0 - math.exp(-move_s / tau_s))  # of the unit when the air arrives
    return max(rule.dwell_s, tau_s * math.log(max(slope / rule.slope_degc_per_min, 1.0)))


def _walk(segments: tuple[Segment, ...], place: Place) -> Iterator[tuple[Place, Simple]]:
    """Every segment with its place in the file, repeats written out."""
    for i, segment in enumerate(segments):
        if isinstance(segment, Repeat):
            for _ in range(segment.times):
                yield from _walk(segment.segments, (*place, i, "segments"))
        else:
            yield (*place, i), segment
