"""A station, a recorder and the sequencer between them, in simulated time: what is commanded, what is seen."""

from types import SimpleNamespace

from bench.acquisition.profile.guards import Guards, Signal
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.wiring import Wiring
from bench.acquisition.station.settings.link import LinkSettings
from bench.acquisition.station.settings.safety import SafeStateSettings
from drivers.chamber import ChamberReading
from drivers.clock import SimClock
from drivers.errors import LinkError

TAU_S = 20.0


class FakeChamber:
    """Air follows the working set point with a time constant; every command is kept with its time."""

    limits = (-40.0, 85.0)

    def __init__(self, clock, native_ramp):
        self.native_ramp, self.commanded, self.faults = native_ramp, None, {}
        self.commands, self.identified, self.odd = [], [], []
        self.deaf, self.unconfirmed = None, False
        self.air = self.working = self.panel = 23.0
        self.on, self.rate, self.tau_s = False, None, TAU_S
        self._clock = clock
        clock.attach(self.step)

    def step(self, t0_s, t1_s):
        if self.on:
            away = self.panel - self.working
            reach = abs(away) if self.rate is None else min(abs(away), self.rate / 60 * (t1_s - t0_s))
            self.working += reach if away > 0 else -reach
            self.air += (self.working - self.air) * (t1_s - t0_s) / self.tau_s

    def set_point(self, target):
        self._command(target, None)

    def ramp_to(self, target, rate):
        self._command(target, rate)

    def _command(self, target, rate):
        now_s = self._clock.now()
        if self.deaf and self.deaf[0] <= now_s < self.deaf[1]:
            raise LinkError("no answer")
        self.commands.append((now_s, target, rate))
        self.panel, self.rate = target, rate
        if self.unconfirmed and target == 33.0:
            self.unconfirmed = False
            raise LinkError("no confirmation")
        self.commanded = target

    def start(self):
        self.commands.append((self._clock.now(), "start", None))
        self.on = True

    def identify(self):
        self.poll()
        self.identified.append(self._clock.now())
        return SimpleNamespace(model="fake")

    def deviations(self):
        return list(self.odd)

    def poll(self):
        now_s = self._clock.now()
        if self.deaf and self.deaf[0] <= now_s < self.deaf[1]:
            raise LinkError("no answer")
        for (from_s, to_s), error in self.faults.items():
            if from_s <= now_s < to_s:
                raise error
        return ChamberReading(now_s, self.air, self.panel, self.working, None, self.on, (), None)


class FakeBench:
    """Station, recorder and sequencer; the unit's sensor is the air."""

    def __init__(self, *guards, native_ramp=True, hooks=None, link=None, **wiring):
        self.clock = SimClock()
        self.chamber = FakeChamber(self.clock, native_ramp)
        self.unit = SimpleNamespace(newest_frame_s=None, temperature=None, doubted_s=0.0, thermometer="temperature")
        self.units, self.missing, self.polled = [self.unit], 2, 0
        self.settings = SimpleNamespace(
            ambient_degc=23.0,
            safe_state=SafeStateSettings(),
            chamber=SimpleNamespace(link=link or LinkSettings(degraded_after_s=5.0, lost_after_s=10.0)),
        )
        self.events, self.readings, self.seen, self.disk_mb = [], 0, [], 1e6
        self.bus_failed_s, self.instruments = 0.0, SimpleNamespace(latest={})
        self.hooks, self.lag_degc = hooks or {}, 0.0
        disk = lambda: {"disk_free_mb": Signal(self.disk_mb, self.clock.now())}  # noqa: E731
        wired = Wiring(onlooker=self.seen.append, surroundings=disk, **wiring)
        self.sequencer = Sequencer(self, Guards(guards), self, wired)

    # station
    def missing_units(self):
        return ["unit X: no sound rate frame"] if self.polled < self.missing else []

    def poll(self):
        self.polled += 1
        now_s = self.clock.now()
        if self.polled >= self.missing:
            self.unit.newest_frame_s, self.unit.temperature = now_s, Signal(self.chamber.air + self.lag_degc, now_s)
        self.hooks.get(round(now_s), lambda bench: None)(self)

    # recorder
    def event(self, kind, text, **facts):
        self.events.append((self.clock.now(), kind, text))

    def reading(self, reading):
        self.readings += 1

    def tick(self):
        pass

    def go(self, *segments):
        profile = profile_from_text("name: p\nsegments:\n" + "".join(f"  - {{{text}}}\n" for text in segments))
        self.sequencer.check_before_start()
        self.sequencer.start_chamber()
        return self.sequencer.run(profile.legs())

    def kinds(self):
        return [kind for _, kind, _ in self.events]
