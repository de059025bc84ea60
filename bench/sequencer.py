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
LINK_LOST_S = 10.0
OFF_S = 10.0
"""A chamber that says that it is off for longer than this while a leg runs has left us."""

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
        self._reading: ChamberReading | None = None
        self._stop: str | None = None
        self._next_s = station.clock.now()
        self._legs = 0
        self._off_since = math.inf

    def request_stop(self, cause: str) -> None:
        """Ask the run to end at the next tick (safe to call from a signal handler)."""
        self._stop = cause

    def check_before_start(self) -> None:
        """Read everything once and evaluate the guards; RunAborted when one of them objects."""
        for _ in range(3):  # guards with a delay need to see the trouble last
            self._tick()

    def start_chamber(self) -> None:
        """Switch the chamber on where it stands, so that nothing jumps."""
        low, high = self._chamber.limits
        self._chamber.set_point(round(min(max(self._air(), low), high), 1))
        self._chamber.start()

    def run(self, legs: Sequence[Leg]) -> list[SegmentResult]:
        """Execute the legs in order; RunAborted or EquipmentError ends the run early, `results` keeps what was."""
        self._legs = len(legs)
        self._off_since = self._clock.now()
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
            self._command(leg)
            outcome, reason = self._follow(leg, from_s)
        except BaseException as error:
            reason = str(error) or type(error).__name__
            raise
        finally:
            result = replace(result, to_s=self._clock.now(), outcome=outcome, reason=reason)
            self.results.append(result)
            self._recorder.event("segment", f"end {leg.name}: {outcome}", phase="end", segment=vars(result))
        return outcome

    def _command(self, leg: Leg) -> None:
        if leg.kind == "ramp" and leg.rate_degc_per_min is not None and self._chamber.native_ramp:
            self._chamber.ramp_to(leg.target_degc, leg.rate_degc_per_min)
        elif leg.kind != "ramp":
            self._chamber.set_point(leg.target_degc)

    def _follow(self, leg: Leg, from_s: float) -> tuple[Outcome, str]:
        settling = Settling(leg.settle, leg.target_degc) if leg.settle is not None else None
        start_degc = self._air() if self._reading is not None else leg.target_degc
        settled_s: float | None = None if settling is not None else from_s
        while True:
            if leg.kind == "ramp" and not self._chamber.native_ramp:
                self._host_step(leg, start_degc, from_s)
            self._tick(leg, from_s)
            now_s = self._clock.now()
            if self._guards.in_force("hold"):
                return "held", "held by " + ", ".join(self._guards.in_force("hold"))
            if settling is not None and settled_s is None and settling.feed(now_s, self._air(), self._unit_degc()):
                settled_s = now_s
                self._recorder.event("settled", f"{leg.name}: settled at {leg.target_degc:g} degC")
            if settled_s is not None and self._complete(leg, now_s, from_s, settled_s):
                return "done", ""
            if now_s - from_s > leg.timeout_s:
                text = settling.reason() if settling is not None else None
                text = text or f"chamber air is {self._air():.2f} degC, target {leg.target_degc:g}"
                return "timeout", f"{text} after {now_s - from_s:.0f} s"

    def _complete(self, leg: Leg, now_s: float, from_s: float, settled_s: float) -> bool:
        if leg.kind == "ramp":
            return abs(self._air() - leg.target_degc) <= leg.arrival_band_degc
        since_s = settled_s if leg.kind == "step" else from_s
        return now_s - since_s >= leg.duration_s

    def _host_step(self, leg: Leg, start_degc: float, from_s: float) -> None:
        """Ramps of a controller without one of its own: a new set point every tick."""
        moved = (leg.rate_degc_per_min or math.inf) / 60.0 * (self._clock.now() + TICK_S - from_s)
        distance = leg.target_degc - start_degc
        self._chamber.set_point(start_degc + math.copysign(min(moved, abs(distance)), distance))

    def _wait_for_release(self, leg: Leg) -> None:
        here = replace(leg, name="hold", kind="soak", rate_degc_per_min=None, settle=None, target_degc=self._air())
        self._chamber.set_point(round(here.target_degc, 1))
        from_s = self._clock.now()
        while self._guards.in_force("hold"):
            self._tick(here, from_s)
        self._recorder.event("hold", f"released after {self._clock.now() - from_s:.0f} s")

    def _tick(self, leg: Leg | None = None, leg_from_s: float = 0.0) -> None:
        self._next_s = max(self._next_s, self._clock.now()) + TICK_S
        self._clock.sleep_until(self._next_s)
        self._read_chamber()
        self._station.poll()
        self._recorder.tick()
        for trip in self._guards.evaluate(self._signals(), self._clock.now()):
            self._recorder.event("guard", trip.text, tripped=trip.tripped, action=trip.guard.action)
        if tripped := self._guards.in_force("abort"):
            raise RunAborted(f"aborted by guard: {', '.join(tripped)}")
        if self._stop is not None:
            raise RunAborted(f"aborted by {self._stop}")
        if leg is not None and self._reading is not None:
            unit_degc = min(self._unit_degc(), default=math.nan)
            holding = tuple(self._guards.in_force("hold"))
            self._onlooker(Status(self._clock.now(), leg, leg_from_s, self._legs, self._reading, unit_degc, holding))

    def _read_chamber(self) -> None:
        try:
            self._reading = self._chamber.poll()
        except LinkError as error:
            self._recorder.event("link", f"chamber does not answer: {error}")
            last_s = self._reading.t_s if self._reading is not None else self._next_s - TICK_S
            if self._clock.now() - last_s > LINK_LOST_S or self._reading is None:
                raise EquipmentError(f"chamber link lost for {self._clock.now() - last_s:.0f} s: {error}") from error
            return
        self._recorder.reading(self._reading)
        self._off_since = self._clock.now() if self._reading.on else self._off_since
        if self._clock.now() - self._off_since > OFF_S:
            raise EquipmentError(f"the chamber has been off for {OFF_S:.0f} s although the run is on")

    def _signals(self) -> dict[str, Signal]:
        signals: dict[str, Signal] = dict(self.extra_signals())
        if self._reading is not None:
            at_s = self._reading.t_s
            signals["chamber_temperature"] = Signal(self._reading.temperature, at_s)
            signals["alarm"] = Signal(float(bool(self._reading.alarm)), at_s)
        frames = [unit.newest_frame_s for unit in self._station.units]
        if frames and all(frame is not None for frame in frames):
            oldest = min(frame for frame in frames if frame is not None)
            signals["frame_age"] = Signal(self._clock.now() - oldest, self._clock.now())
        temperatures = [unit.temperature for unit in self._station.units]
        known = [signal for signal in temperatures if signal is not None]
        if known and len(known) == len(temperatures):
            worst = max(known, key=lambda signal: signal.value)
            signals["unit_temperature"] = worst
            if self._reading is not None:
                apart = max(abs(signal.value - self._reading.temperature) for signal in known)
                signals["sensor_disagreement"] = Signal(apart, min(s.t_s for s in known))
        return signals

    def _air(self) -> float:
        return math.nan if self._reading is None else self._reading.temperature

    def _unit_degc(self) -> list[float]:
        return [math.nan if unit.temperature is None else unit.temperature.value for unit in self._station.units]
