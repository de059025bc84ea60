"""Executes a profile: one loop, one tick a second of bench time, on one clock.

Each tick waits, reads the chamber, drains the captures, evaluates the guards and moves the leg on. A ramp is never
rewound: when a guard holds the run, the leg ends as `held`, the chamber stays where it is, and the leg is continued
as a new, marked segment. A leg that does not get where it should in its time is a failed segment, never a silent
pass. The sequencer never sleeps, never writes files and never decides what is safe: it raises, and the runner makes
the equipment safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from bench.errors import EquipmentError, RunAborted
from bench.guards import Guards, Signal
from bench.profile import Leg
from bench.recorder import Recorder
from bench.settling import Settling
from bench.station import Station
from drivers.chamber import ChamberReading
from drivers.errors import LinkError

TICK_S = 1.0
APPEAR_S = 10.0
"""Every unit has to be heard within this time, or nothing starts."""
ARRIVED_DEGC = 0.05
"""A working set point this near to the target has arrived; controllers display tenths."""
LINK_LOST_S = 10.0
OFF_S = 10.0
"""A chamber that says that it is off for longer than this while a leg runs has left us."""
OVERRIDE_S = 3.0
OVERRIDE_DEGC = 0.2
"""A set point that is this far from ours for longer than that is somebody else's."""

Outcome = Literal["done", "timeout", "held", "interrupted"]


@dataclass(frozen=True)
class SegmentResult:
    """One executed segment: when, how it ended, and why if not as planned."""

    index: int
    name: str
    kind: str
    from_s: float
    to_s: float
    target_degc: float
    rate_degc_per_min: float | None
    direction: str
    outcome: Outcome = "interrupted"
    reason: str = ""


@dataclass(frozen=True)
class Status:
    """What an onlooker may want to know, once a tick."""

    t_s: float
    leg: Leg
    leg_from_s: float
    legs: int
    reading: ChamberReading
    unit_degc: float
    holding: tuple[str, ...]


class Sequencer:
    """Runs legs on a chamber while units are captured."""

    def __init__(
        self,
        station: Station,
        guards: Guards,
        recorder: Recorder,
        onlooker: Callable[[Status], None],
    ) -> None:
        self._station, self._clock, self._chamber = station, station.clock, station.chamber
        self._guards, self._recorder, self._onlooker = guards, recorder, onlooker
        self.extra_signals: Callable[[], Mapping[str, Signal]] = dict
        self.results: list[SegmentResult] = []
        self.moved = False
        """Whether the chamber was commanded; if not, it is still as it was found."""
        self._reading: ChamberReading | None = None
        self._stop: str | None = None
        self._next_s = station.clock.now()
        self._legs = 0
        self._since: dict[str, float] = {}

    def request_stop(self, cause: str) -> None:
        """Ask the run to end at the next tick (safe to call from a signal handler)."""
        self._stop = cause

    def check_before_start(self) -> None:
        """Hear every unit, read everything, evaluate the guards; nothing has moved yet.

        Raises EquipmentError when a unit is not there, RunAborted when a guard objects, its delay over or not.
        """
        until_s = self._clock.now() + APPEAR_S
        while missing := self._station.missing_units():
            if self._clock.now() >= until_s:
                raise EquipmentError(f"not started: {'; '.join(missing)}")
            self._sleep()
            self._station.poll()
        self._tick()
        if troubles := self._guards.troubles():
            raise RunAborted(f"not started: {'; '.join(troubles)}")

    def start_chamber(self) -> None:
        """Switch the chamber on where it stands, so that nothing jumps."""
        self.moved = True
        self._chamber.set_point(self._here())
        self._chamber.start()

    def run(self, legs: Sequence[Leg]) -> list[SegmentResult]:
        """Execute the legs in order; RunAborted or EquipmentError ends the run early, `results` keeps what was."""
        self._legs = len(legs)
        for leg in legs:
            part = leg
            while self._run_leg(part) == "held":
                self._wait_for_release(leg)
                part = replace(leg, name=f"{leg.name} (resumed)")
        return self.results

    def _run_leg(self, leg: Leg) -> Outcome:
        from_s = self._clock.now()
        result = SegmentResult(
            len(self.results), leg.name, leg.kind, from_s, from_s, leg.target_degc, leg.rate_degc_per_min, leg.direction
        )
        self._recorder.event("segment", f"start {leg.name}", phase="start", segment=vars(result))
        outcome: Outcome = "interrupted"
        reason = ""
        try:
            outcome, reason = self._follow(leg, from_s)
        except BaseException as error:
            reason = str(error) or type(error).__name__
            raise
        finally:
            result = replace(result, to_s=self._clock.now(), outcome=outcome, reason=reason)
            self.results.append(result)
            self._recorder.event("segment", f"end {leg.name}: {outcome}", phase="end", segment=vars(result))
        return outcome

    def _follow(self, leg: Leg, from_s: float) -> tuple[Outcome, str]:
        """Command the leg and tick until it is over; how it ended, and why if not as planned."""
        command = self._commands(leg, from_s)
        settling = Settling(leg.settle, leg.target_degc) if leg.settle is not None else None
        settled_s: float | None = None if settling is not None else from_s
        while True:
            command()
            self._tick(leg, from_s)
            now_s = self._clock.now()
            if holding := self._guards.in_force("hold"):
                return "held", "; ".join(holding)
            if settling is not None and settled_s is None and settling.feed(now_s, self._air(), self._unit_degc()):
                settled_s = now_s
                self._recorder.event("settled", f"{leg.name}: settled at {leg.target_degc:g} degC")
            if settled_s is not None and self._complete(leg, now_s, from_s, settled_s):
                return "done", ""
            if now_s - from_s > leg.timeout_s:
                text = None if settling is None else settling.reason
                text = text or f"chamber air is {self._air():.2f} degC, target {leg.target_degc:g}"
                return "timeout", f"{text} after {now_s - from_s:.0f} s"

    def _commands(self, leg: Leg, from_s: float) -> Callable[[], None]:
        """What to command before each tick of a leg; the controller's own ramp and a jump are commanded once, now."""
        rate = leg.rate_degc_per_min
        if leg.kind != "ramp" or rate is None:
            self._chamber.set_point(leg.target_degc)
        elif self._chamber.native_ramp:
            self._chamber.ramp_to(leg.target_degc, rate)
        else:
            start_degc = self._here() if self._chamber.commanded is None else self._chamber.commanded
            return lambda: self._host_step(leg, start_degc, rate * (self._clock.now() + TICK_S - from_s) / 60.0)
        return lambda: None

    def _host_step(self, leg: Leg, start_degc: float, reach_degc: float) -> None:
        """Ramps of a controller without one of its own: a new set point every tick."""
        distance = leg.target_degc - start_degc
        arrived = reach_degc >= abs(distance)
        self._chamber.set_point(leg.target_degc if arrived else start_degc + math.copysign(reach_degc, distance))

    def _complete(self, leg: Leg, now_s: float, from_s: float, settled_s: float) -> bool:
        if leg.kind == "ramp":
            return self._commanded_all(leg) and abs(self._air() - leg.target_degc) <= leg.arrival_band_degc
        since_s = settled_s if leg.kind == "step" else from_s
        return now_s - since_s >= leg.duration_s

    def _commanded_all(self, leg: Leg) -> bool:
        """Whether the set point in force is that of the end of the ramp."""
        in_force = None if self._reading is None else self._reading.working_setpoint
        in_force = self._chamber.commanded if in_force is None else in_force
        return in_force is not None and abs(in_force - leg.target_degc) < ARRIVED_DEGC

    def _wait_for_release(self, leg: Leg) -> None:
        here = replace(leg, name="hold", kind="soak", rate_degc_per_min=None, settle=None, target_degc=self._here())
        self._chamber.set_point(here.target_degc)
        from_s = self._clock.now()
        while self._guards.in_force("hold"):
            self._tick(here, from_s)
        self._recorder.event("hold", f"released after {self._clock.now() - from_s:.0f} s")

    def _sleep(self) -> None:
        """Wait for the next tick; one that was missed is not made up for."""
        self._next_s = max(self._next_s + TICK_S, self._clock.now())
        self._clock.sleep_until(self._next_s)
        if self._stop is not None:
            raise RunAborted(f"aborted by {self._stop}")

    def _tick(self, leg: Leg | None = None, leg_from_s: float = 0.0) -> None:
        self._sleep()
        self._read_chamber()
        self._station.poll()
        self._recorder.tick()
        for trip in self._guards.evaluate(self._signals(), self._clock.now()):
            self._recorder.event("guard", trip.text, tripped=trip.tripped, action=trip.guard.action)
        if self.moved and (tripped := self._guards.in_force("abort")):
            raise RunAborted(f"aborted by guard: {'; '.join(tripped)}")
        if leg is not None and self._reading is not None:
            unit_degc = min(self._unit_degc(), default=math.nan)
            holding = tuple(self._guards.in_force("hold"))
            self._onlooker(Status(self._clock.now(), leg, leg_from_s, self._legs, self._reading, unit_degc, holding))

    def _read_chamber(self) -> None:
        try:
            reading = self._chamber.poll()
        except LinkError as error:
            if "link" not in self._since:
                self._recorder.event("link", f"chamber does not answer: {error}")
            if self._lasts("link", True) >= LINK_LOST_S or self._reading is None:
                raise EquipmentError(f"chamber link lost for {self._lasts('link', True):.0f} s: {error}") from error
            return
        self._reading = reading
        self._recorder.reading(reading)
        self._lasts("link", False)
        if self._lasts("off", self.moved and not reading.on) > OFF_S:
            raise EquipmentError(f"the chamber has been off for {OFF_S:.0f} s although the run is on")
        self._check_override(reading)

    def _check_override(self, reading: ChamberReading) -> None:
        """Two masters: what the chamber does is no longer what the profile says."""
        ours = self._chamber.commanded
        foreign = ours is not None and abs(reading.setpoint - ours) > OVERRIDE_DEGC
        text = f"set point is {reading.setpoint:g} degC, the bench commanded {ours}: somebody else commands the chamber"
        if foreign and "override" not in self._since:
            self._recorder.event("override", text)
        if self._lasts("override", foreign) > OVERRIDE_S:
            raise EquipmentError(text)

    def _lasts(self, trouble: str, present: bool) -> float:
        """How long a trouble has lasted without a break [s]."""
        if not present:
            self._since.pop(trouble, None)
            return 0.0
        return self._clock.now() - self._since.setdefault(trouble, self._clock.now())

    def _signals(self) -> dict[str, Signal]:
        signals: dict[str, Signal] = dict(self.extra_signals())
        reading, units = self._reading, self._station.units
        if reading is not None:
            signals["chamber_temperature"] = Signal(reading.temperature, reading.t_s)
            signals["alarm"] = Signal(float(bool(reading.alarm)), reading.t_s)
        frames = [unit.newest_frame_s for unit in units if unit.newest_frame_s is not None]
        if frames and len(frames) == len(units):
            signals["frame_age"] = Signal(self._clock.now() - min(frames), self._clock.now())
        known = [unit.temperature for unit in units if unit.temperature is not None]
        if known and len(known) == len(units):
            oldest_s = min(signal.t_s for signal in known)
            signals["unit_temperature"] = Signal(max(signal.value for signal in known), oldest_s)
            if reading is not None:
                apart = max(abs(signal.value - reading.temperature) for signal in known)
                signals["sensor_disagreement"] = Signal(apart, min(oldest_s, reading.t_s))
        return signals

    def _air(self) -> float:
        return math.nan if self._reading is None else self._reading.temperature

    def _here(self) -> float:
        """The set point that keeps the chamber where it is: its air, or the limit that is nearest to it [degC]."""
        low, high = self._chamber.limits
        return round(min(max(self._air(), low), high), 1)

    def _unit_degc(self) -> list[float]:
        return [math.nan if unit.temperature is None else unit.temperature.value for unit in self._station.units]
