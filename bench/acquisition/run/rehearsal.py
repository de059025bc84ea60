"""A rehearsal: the real sequencer runs the profile on the plant model alone, without wires, frames or files.

It tells how long a profile takes on a chamber that cannot always follow, and which legs would time out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from bench.acquisition.profile.guards import Guards, Signal, guards_of
from bench.acquisition.profile.profile import Profile
from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.signals import told_by
from bench.acquisition.run.status import SegmentResult
from bench.acquisition.run.wiring import Wiring
from bench.acquisition.station.settings.station import StationSettings
from bench.base import BenchError
from drivers.chamber import ChamberReading
from drivers.clock import SimClock
from drivers.registers import load_map
from drivers.sim.plant import Plant, PlantParameters

if TYPE_CHECKING:
    from bench.acquisition.station.station import Station


class _Chamber:
    """The plant model with the commands of a chamber."""

    native_ramp = True
    commanded = None  # nobody else commands a model

    def __init__(self, settings: StationSettings, clock: SimClock) -> None:
        self.limits = settings.chamber.lowest_degc, settings.chamber.highest_degc
        self.plant = Plant(PlantParameters(ambient_degc=settings.ambient_degc), seed=settings.seed)
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

    InputError for a guard on a signal that the controller of this station never tells.
    """
    standing = [one.guard for one in settings.standing_guards()]
    guards_of(settings.guards, profile.guards, told_by(load_map(settings.chamber.map)), standing=standing)
    sequencer = Sequencer(cast("Station", _Bench(settings)), Guards(()), cast(Recorder, _NoRecorder()), Wiring())
    try:
        sequencer.check_before_start()
        sequencer.start_chamber()
        sequencer.run(profile.legs())
    except BenchError:
        pass  # the results say how far it came
    return sequencer.results
