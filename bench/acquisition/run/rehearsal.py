"""A rehearsal: the real sequencer runs the profile on the plant model alone, without wires, frames or files.

It tells how long a profile takes on a chamber that cannot always follow, and which legs would time out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, cast

from bench.acquisition.profile.guards import Guards, Signal, guards_of, told_by
from bench.acquisition.profile.legs import Leg
from bench.acquisition.profile.profile import Profile
from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.status import SegmentResult
from bench.acquisition.run.wiring import Wiring
from bench.acquisition.station.fixture import Fixture
from bench.acquisition.station.records import Journal
from bench.acquisition.station.settings.station import StationSettings
from bench.base import BenchError
from drivers.chamber import ChamberReading
from drivers.clock import SimClock
from drivers.registers import load_map

if TYPE_CHECKING:
    from bench.acquisition.station.station import Station


SOAK_S = 4 * 3600.0
"""After so long nothing moves any more."""
LONGEST_S = 3 * 86_400.0


class _Chamber:
    """The plant model with the commands of a chamber."""

    native_ramp = True
    commanded = None  # nobody else commands a model

    def __init__(self, settings: StationSettings, clock: SimClock) -> None:
        self.limits = settings.chamber.lowest_degc, settings.chamber.highest_degc
        self.plant = settings.plant(settings.seed)
        self._clock = clock
        self._target = settings.ambient_degc
        self._rate: float | None = None
        clock.attach(self._step)

    def _step(self, t0_s: float, t1_s: float) -> None:
        self.plant.step(t1_s - t0_s, self._target, on=True, ramp_degc_per_min=self._rate)

    def set_point(self, target: float) -> None:
        self._target, self._rate = target, None

    def ramp_to(self, target: float, rate: float) -> None:
        self._target, self._rate = target, rate

    def start(self) -> None:
        """The model is always on."""

    def poll(self) -> ChamberReading:
        state = self.plant.state
        return ChamberReading(
            self._clock.now(), state.process_value, state.setpoint, state.working_setpoint, state.power, True, (), None
        )


@dataclass
class _Unit:
    chamber: _Chamber
    clock: SimClock
    newest_frame_s: float | None = None
    doubted_s = 0.0
    thermometer = "temperature"

    @property
    def temperature(self) -> Signal:
        return Signal(self.chamber.plant.state.case, self.clock.now())


class _Bench:
    """What the sequencer sees of a station."""

    bus_failed_s = 0.0

    def __init__(self, settings: StationSettings) -> None:
        self.settings = settings
        self.clock = SimClock()
        self.chamber = _Chamber(settings, self.clock)
        self.units = [_Unit(self.chamber, self.clock)]

    def placing(self) -> Fixture | None:
        """A fixture that is turned in the time that the station file says."""
        fixture = self.settings.fixture
        unattended = (
            None if fixture is None else fixture.model_copy(update={"operator": "simulated", "forgets": (), "turn": ()})
        )
        return None if unattended is None else Fixture(unattended, self.clock, cast(Journal, _NoRecorder()))

    def missing_units(self) -> list[str]:
        return []

    def poll(self) -> None:
        """Nothing is captured."""


class _NoRecorder:
    def event(self, kind: str, text: str, **facts: Any) -> None:
        pass

    def reading(self, reading: ChamberReading) -> None:
        pass

    def tick(self) -> None:
        pass


def rehearse(profile: Profile, settings: StationSettings) -> Sequence[SegmentResult]:
    """Segments as the plant model would run them, in bench time [s].

    InputError for a guard on a signal that the controller of this station never tells; ConfigError for a gyro's DBC
    that cannot be used. Of a soak no more than `SOAK_S` is modelled; a profile that is still longer than `LONGEST_S`
    has the times that it says itself.
    """
    for unit in settings.units:
        unit.decoder()
    standing = [one.guard for one in settings.standing_guards()]
    guards_of(
        settings.guards,
        profile.guards,
        {*told_by(load_map(settings.chamber.map).registers), *settings.measured()},
        standing=standing,
    )
    bench = _Bench(settings)
    sequencer = Sequencer(
        cast("Station", bench), Guards(()), cast(Recorder, _NoRecorder()), Wiring(placing=bench.placing())
    )
    legs = profile.legs()
    skipped = [max(leg.duration_s - SOAK_S, 0.0) if leg.kind == "soak" else 0.0 for leg in legs]
    if sum(leg.nominal_s for leg in legs) - sum(skipped) > LONGEST_S:
        return [_nominal(leg) for leg in legs]
    shorter = [replace(leg, duration_s=leg.duration_s - less) for leg, less in zip(legs, skipped, strict=True)]
    try:
        sequencer.check_before_start()
        sequencer.start_chamber()
        sequencer.run(shorter)
    except BenchError:
        pass  # the results say how far it came
    return [*_lengthened(sequencer.results, skipped)]


def _lengthened(results: Sequence[SegmentResult], skipped: Sequence[float]) -> Iterator[SegmentResult]:
    """The segments with what was left out of them; the last may be the way home, which is no leg."""
    later = 0.0
    for result, less in zip_longest(results, skipped[: len(results)], fillvalue=0.0):
        assert isinstance(result, SegmentResult)
        more = less if isinstance(less, float) and result.outcome == "done" else 0.0
        yield replace(result, from_s=result.from_s + later, to_s=result.to_s + later + more)
        later += more


def _nominal(leg: Leg) -> SegmentResult:
    """A leg as the profile says it."""
    end_s = leg.nominal_start_s + leg.nominal_s
    text = "the times of the profile itself: it is too long to be rehearsed"
    rate = leg.rate_degc_per_min
    return SegmentResult(
        leg.index, leg.name, leg.kind, leg.nominal_start_s, end_s, leg.target_degc, rate, leg.direction, "done", text
    )
