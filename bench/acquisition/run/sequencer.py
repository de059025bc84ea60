"""Executes a profile: one loop, one tick a second of bench time, on one clock.

Each tick waits, reads the chamber, drains the captures, evaluates the guards and moves the leg on. A ramp is never
rewound: when a guard or an operator holds the run, the leg ends as `held`, the chamber stays where it is, and the leg
is continued as a new, marked segment. A leg that does not get where it should in its time is a failed segment, never a
silent pass. A run that ends cold returns to ambient first, so that nothing frosts. The chamber is switched on once and
never off: the sequencer never sleeps, never writes files and never decides what is safe. It raises, and the runner
makes the equipment safe.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from bench.acquisition.profile.guards import OF_UNITS, Guards
from bench.acquisition.profile.legs import Leg
from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.continuation import rest_of
from bench.acquisition.run.operating import Operating
from bench.acquisition.run.settling import Settling
from bench.acquisition.run.signals import Signals
from bench.acquisition.run.status import Outcome, SegmentResult, Status
from bench.acquisition.run.wiring import Stop, Wiring
from bench.acquisition.station.links import ChamberLink
from bench.acquisition.station.safety import home_leg
from bench.base import EquipmentError, RunAborted
from drivers.chamber import ChamberReading

if TYPE_CHECKING:
    from bench.acquisition.station.station import Station

TICK_S = 1.0
APPEAR_S = 10.0
"""Every unit has to be heard within this time, or nothing starts."""
ARRIVED_DEGC = 0.05
"""A working set point this near to the target has arrived; controllers display tenths."""


class _SafeStop(RunAborted):
    """A guard ends the profile but not the recording."""


class _EndedEarly(Exception):  # noqa: N818 (the run is done)
    """Whoever was asked whether the run goes on said that it need not."""


def _begins_anew(leg: Leg) -> bool:
    """Whether a leg is done again whole after a hold; a ramp goes on from where the chamber is."""
    return leg.kind != "ramp"


class Sequencer:
    """Runs legs on a chamber while units are captured."""

    def __init__(
        self,
        station: Station,
        guards: Guards,
        recorder: Recorder,
        wiring: Wiring,
    ) -> None:
        """`wiring` says who answers what the sequencer asks."""
        self._station, self._clock, self._chamber = station, station.clock, station.chamber
        self._guards, self._recorder, self._wiring = guards, recorder, wiring
        self._link = ChamberLink(station.chamber, station.clock, station.settings.chamber.link, recorder.event)
        placing = wiring.placing
        self._operating = Operating(recorder.event, (lambda who: None) if placing is None else placing.confirm)
        self._signals = Signals(station, self._link, wiring.surroundings, wiring.plausible)
        self.results: list[SegmentResult] = []
        self.moved = False
        """Whether the chamber was commanded; if not, it is still as it was found."""
        self.decision: Stop | None = None
        """Who ended the run early, and why; None: nobody."""
        self._reading: ChamberReading | None = None
        self._next_s = station.clock.now()
        self._legs = 0
        self._homeward = False

    @property
    def asked_to_stop(self) -> bool:
        """Whether a stop was asked for that is not in force yet; once the run is over, somebody is in a hurry."""
        return self._operating.asked_to_stop

    def request_stop(self, cause: str) -> None:
        """Ask the run to end at the next tick. Like all requests from any thread or signal handler; `cause`: who."""
        self._operating.ask("stop", cause)

    def request_hold(self, cause: str) -> None:
        """Hold at the next tick, the chamber where it is; the segment is continued later as a marked one."""
        self._operating.ask("hold", cause)

    def request_pause(self, cause: str) -> None:
        """Hold after the present segment."""
        self._operating.ask("pause", cause)

    def request_resume(self, cause: str) -> None:
        """Go on after a hold or a pause; guards that hold the run go on holding it."""
        self._operating.ask("resume", cause)

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
        if self._reading is None:
            raise EquipmentError("not started: the chamber does not answer")
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
        try:
            for leg in legs:
                self._execute(leg)
        except _EndedEarly:
            pass
        except _SafeStop as stop:
            self._go_home(legs)
            raise RunAborted(f"{stop}; the chamber is back at ambient") from None
        safe, ambient_degc = self._station.settings.safe_state, self._station.settings.ambient_degc
        if self._air() < ambient_degc - safe.near_degc:
            self._go_home(legs)
        return self.results

    def _execute(self, leg: Leg) -> None:
        """Run a leg to its end, through as many holds as there are; hold after it when that was asked for."""
        self._place(leg)
        part = leg
        while self._run_leg(part) == "held":
            part = rest_of(leg, self._here())
            self._wait_for_release(part, self._waits_at(leg), anew=_begins_anew(leg))
        self._operating.segment_is_over()
        if self._operating.hold:
            over = replace(leg, nominal_s=0.0, nominal_start_s=leg.nominal_end_s)
            self._wait_for_release(over, leg.target_degc)

    def _place(self, leg: Leg) -> None:
        """Bring the units into the attitude of a leg; the chamber stays where it is until they stand so."""
        placing = self._wiring.placing
        if placing is not None and leg.attitude is not None and leg.attitude != placing.attitude:
            placing.ask(leg.attitude)
            self._wait_for_release(leg, self._waits_at(leg))

    def _waits_at(self, leg: Leg) -> float:
        stays = leg.kind in ("soak", "rate", "power_cycle")
        return leg.target_degc if stays else self._here()

    def _go_home(self, legs: Sequence[Leg]) -> None:
        """Take the chamber to ambient, recording, no faster than the profile moves it; nothing holds this up."""
        if (leg := home_leg(self._station.settings, legs, self._air())) is not None:
            self._homeward, self._legs = True, len(legs) + 1
            self._run_leg(leg)

    def _run_leg(self, leg: Leg) -> Outcome:
        from_s = self._clock.now()
        result = SegmentResult(
            len(self.results),
            leg.name,
            leg.kind,
            from_s,
            from_s,
            leg.target_degc,
            leg.rate_degc_per_min,
            leg.direction,
            attitude=leg.attitude,
            heading_deg=0.0 if self._wiring.placing is None else self._wiring.placing.heading_deg,
        )
        self._recorder.event("segment", f"start {leg.name}", phase="start", segment=vars(result))
        outcome: Outcome = "interrupted"
        reason = ""
        try:
            outcome, reason = self._follow(leg, from_s)
        except _EndedEarly as end:
            outcome, reason = "ended", str(end)
            raise
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
        rate = leg.rate_degc_per_min if leg.kind == "ramp" else None
        drive, driven = self._link.way_to(leg.target_degc, rate, self._here()), False
        table = self._wiring.table
        turning, turned = None if table is None else table.begin(leg), True
        power = self._wiring.power if leg.kind == "power_cycle" else None
        cycling, powered = None if power is None else power.begin(leg), True
        settling = Settling(leg.settle, leg.target_degc) if leg.settle is not None else None
        settled_s: float | None = None if settling is not None else from_s
        try:
            while True:
                driven = driven or drive()
                self._tick(leg, from_s)
                now_s = self._clock.now()
                if holding := self._holding():
                    return "held", "; ".join(holding)
                if settling is not None and settled_s is None and self._settles(settling, now_s):
                    settled_s = now_s
                    self._recorder.event("settled", f"{leg.name}: settled at {leg.target_degc:g} degC")
                if turning is not None:
                    turned = turning.tick(now_s, settled_s is not None)
                if cycling is not None:
                    powered = cycling.tick(now_s)
                ready = driven and turned and powered
                if settled_s is not None and ready and self._complete(leg, now_s, from_s, settled_s):
                    return "done", ""
                if now_s - from_s > leg.timeout_s:
                    text = None if settling is None else settling.reason
                    text = text or f"chamber air is {self._air():.2f} degC, target {leg.target_degc:g}"
                    return "timeout", f"{text} after {now_s - from_s:.0f} s"
        finally:
            if cycling is not None:
                cycling.stop()
            if turning is not None:
                turning.stop()

    def _complete(self, leg: Leg, now_s: float, from_s: float, settled_s: float) -> bool:
        if leg.kind == "ramp":
            arrived = self._commanded_all(leg) and abs(self._fresh_air() - leg.target_degc) <= leg.arrival_band_degc
            lasted = now_s - from_s >= leg.least_s
            return arrived and lasted and not (self._homeward and self._units_cold(leg))
        since_s = settled_s if leg.kind == "step" else from_s
        return now_s - since_s >= leg.duration_s

    def _units_cold(self, leg: Leg) -> bool:
        """Whether a unit is still so much colder than the target that it would collect water."""
        return any(degc < leg.target_degc - leg.arrival_band_degc for degc in self._unit_degc())

    def _commanded_all(self, leg: Leg) -> bool:
        """Whether the set point in force is that of the end of the ramp."""
        in_force = None if self._reading is None else self._reading.working_setpoint
        in_force = self._chamber.commanded if in_force is None else in_force
        return in_force is not None and abs(in_force - leg.target_degc) < ARRIVED_DEGC

    def _wait_for_release(self, leg: Leg, at_degc: float, anew: bool = False) -> None:
        """Keep the chamber at `at_degc` [degC] and record until nothing holds the run any more.

        What is left of `leg` stays left as long as that lasts.
        """
        here = replace(leg, name="hold", kind="soak", rate_degc_per_min=None, settle=None, target_degc=at_degc)
        self._recorder.event("hold", f"held at {at_degc:g} degC: {'; '.join(self._holding())}", phase="start")
        from_s, commanded = self._clock.now(), False
        while self._holding():
            commanded = commanded or self._link.set_point(at_degc)
            self._tick(here, self._clock.now(), anew)
        self._recorder.event("hold", f"released after {self._clock.now() - from_s:.0f} s", phase="end")

    def _holding(self) -> tuple[str, ...]:
        """What holds the run; on the way to ambient nothing does."""
        if self._homeward:
            return ()
        waiting = "" if self._wiring.placing is None else self._wiring.placing.waiting
        return (*self._guards.in_force("hold"), *self._operating.holding, *filter(None, [waiting]))

    def _sleep(self) -> None:
        """Wait for the next tick; one that was missed is not made up for."""
        self._next_s = max(self._next_s + TICK_S, self._clock.now())
        self._clock.sleep_until(self._next_s)
        self._wiring.heart.beat()
        self._operating.take()

    def _tick(self, leg: Leg | None = None, leg_from_s: float = 0.0, anew: bool | None = None) -> None:
        self._sleep()
        if (reading := self._link.poll()) is not None:
            self._reading = reading
            self._recorder.reading(reading)
            self._signals.take(reading, ours_on=self.moved)
        self._station.poll()
        self._recorder.tick()
        if self._wiring.placing is not None:
            self._wiring.placing.tick()
        self._guard()
        if leg is not None and self._reading is not None:
            unit_degc = min(self._unit_degc(), default=math.nan)
            holding = self._holding()
            state: Literal["running", "holding", "pausing"] = "pausing" if self._operating.pause else "running"
            state = "holding" if holding else state
            now_s = self._clock.now()
            anew = _begins_anew(leg) and not self._homeward if anew is None else anew
            status = Status(now_s, leg, leg_from_s, self._legs, self._reading, unit_degc, holding, state, anew)
            self._wiring.onlooker(status)
            self._ask_whether_to_go_on(status)

    def _ask_whether_to_go_on(self, status: Status) -> None:
        if self._homeward:
            return
        decision = self._wiring.decider.decide(status)
        if isinstance(decision, Stop):
            self.decision = decision
            self._recorder.event("decision", str(decision), who=decision.who, reason=decision.reason, **decision.facts)
            raise _EndedEarly(str(decision))
        if decision.text:
            self._recorder.event("decision", decision.text, **decision.facts)

    def _guard(self) -> None:
        """Evaluate the guards; RunAborted when one of them ends the run."""
        if not self._guards.settings:
            return  # a rehearsal has none, and its signals need not be collected
        asleep = OF_UNITS if self._wiring.power is not None and self._wiring.power.cycling else ()
        for trip in self._guards.evaluate(self._signals.collect(), self._clock.now(), asleep):
            self._recorder.event("guard", trip.text, tripped=trip.tripped, action=trip.guard.action)
        if not self.moved:
            return
        if tripped := self._guards.in_force("abort"):
            raise RunAborted(f"aborted by guard: {'; '.join(tripped)}")
        if not self._homeward and (tripped := self._guards.in_force("safe")):
            raise _SafeStop(f"profile ended by guard: {'; '.join(tripped)}")

    def _settles(self, settling: Settling, now_s: float) -> bool:
        return settling.feed(now_s, self._fresh_air(), self._unit_degc())

    def _air(self) -> float:
        """Chamber air as it was read last [degC]."""
        return math.nan if self._reading is None else self._reading.temperature

    def _fresh_air(self) -> float:
        """The same; NaN while the chamber does not answer: an old value has neither arrived nor settled."""
        return math.nan if self._link.link.failing else self._air()

    def _here(self) -> float:
        """The set point that keeps the chamber where it is: its air, or the limit that is nearest to it [degC]."""
        low, high = self._chamber.limits
        return round(min(max(self._air(), low), high), 1)

    def _unit_degc(self) -> list[float]:
        """Of each unit; the air of the chamber where a unit has no thermometer, NaN where it was not heard."""
        air = self._fresh_air()
        found = [unit.temperature if unit.thermometer else None for unit in self._station.units]
        return [
            air if not unit.thermometer else math.nan if own is None else own.value
            for unit, own in zip(self._station.units, found, strict=True)
        ]
