"""The sequencer on a fake station in simulated time: ramps, holds, timeouts, lost links, two masters."""

from itertools import pairwise
from types import SimpleNamespace

import pytest

from bench.acquisition.profile.guards import DEFAULT_GUARDS, Guards, GuardSettings, Signal
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.control import time_left
from bench.acquisition.run.sequencer import Sequencer
from bench.acquisition.run.wiring import Continue, Stop, Wiring
from bench.acquisition.station.settings.link import LinkSettings
from bench.acquisition.station.settings.safety import SafeStateSettings
from bench.base.errors import EquipmentError, RunAborted
from drivers.chamber import ChamberReading
from drivers.clock import SimClock
from drivers.errors import LimitError, LinkError

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

    def go(self, *segments, start=True):
        profile = profile_from_text("name: p\nsegments:\n" + "".join(f"  - {{{text}}}\n" for text in segments))
        if start:
            self.sequencer.check_before_start()
            self.sequencer.start_chamber()
        return self.sequencer.run(profile.legs())

    def kinds(self):
        return [kind for _, kind, _ in self.events]


RAMP = "kind: ramp, to_degc: 33, rate_degc_per_min: 2"


OVERRIDE = next(guard for guard in DEFAULT_GUARDS if guard.signal == "override")


def hold_guard(**settings):
    return GuardSettings(name="hot", signal="disk_free_mb", action="hold", release_delay_s=5.0, **settings)


def test_a_ramp_is_commanded_once_and_ends_when_the_air_has_arrived():
    bench = FakeBench()
    (ramp,) = bench.go(RAMP)
    assert bench.chamber.commands[2:] == [(ramp.from_s, 33.0, 2.0)]
    assert ramp.outcome == "done"
    assert ramp.to_s - ramp.from_s == pytest.approx(60 * 10 / 2, abs=3)  # the air follows within the arrival band
    assert (ramp.kind, ramp.direction, ramp.rate_degc_per_min) == ("ramp", "heating", 2.0)


def test_the_chamber_starts_where_it_stands():
    bench = FakeBench()
    bench.chamber.air = 27.34
    bench.go(RAMP)
    assert bench.chamber.commands[:2] == [(3.0, 27.3, None), (3.0, "start", None)]


def test_a_controller_without_ramps_gets_a_new_set_point_every_tick():
    bench = FakeBench(native_ramp=False)
    (ramp,) = bench.go(RAMP)
    times, targets, rates = zip(*bench.chamber.commands[2:], strict=True)
    assert set(rates) == {None}
    assert times == tuple(ramp.from_s + i for i in range(len(times)))
    assert targets[:3] == pytest.approx([23 + 2 / 60, 23 + 4 / 60, 23 + 6 / 60])
    assert max(targets) <= 33.0
    native = FakeBench().go(RAMP)[0]
    assert ramp.to_s - ramp.from_s == pytest.approx(native.to_s - native.from_s, abs=2)


def test_a_host_stepped_ramp_goes_on_from_the_set_point_and_not_from_the_lagging_air():
    bench = FakeBench(native_ramp=False)
    up, down = bench.go(RAMP, "kind: ramp, to_degc: 23, rate_degc_per_min: 2")
    first = next(target for t_s, target, _ in bench.chamber.commands[2:] if t_s == down.from_s)
    before = [target for t_s, target, _ in bench.chamber.commands[2:] if t_s < down.from_s][-1]
    assert first == pytest.approx(before - 2 / 60)
    assert down.outcome == up.outcome == "done"


def test_a_soak_lasts_as_long_as_it_should():
    _, soak = FakeBench().go(RAMP, "kind: soak, duration_min: 3")
    assert soak.to_s - soak.from_s == 180.0


def test_a_step_waits_for_the_unit_to_settle_and_then_averages():
    settle = "settle: {dwell_min: 1, band_degc: 0.5, slope_degc_per_min: 5}"
    bench = FakeBench()
    move, stay = bench.go(f"kind: step, temperatures_degc: [33], average_min: 2, {settle}")
    assert (move.outcome, stay.outcome) == ("done", "done")
    assert move.to_s - move.from_s == pytest.approx(20 * 3.0 + 60, abs=3)  # ln(10 / 0.5) time constants, and the dwell
    assert stay.to_s - stay.from_s == 120.0
    assert "settled" in bench.kinds()


def test_what_does_not_settle_in_its_time_is_a_failed_segment_with_its_reason():
    bench = FakeBench()
    settle = "settle: {dwell_min: 1, slope_degc_per_min: 0.0001, timeout_min: 0.1}"
    move, stay = bench.go(f"kind: step, temperatures_degc: [33], average_min: 1, {settle}")
    assert move.outcome == "timeout"
    assert "unit sensor moves by" in move.reason
    assert stay.outcome == "done"


def test_a_ramp_that_does_not_arrive_is_a_failed_segment():
    bench = FakeBench(hooks={10: lambda bench: setattr(bench.chamber, "tau_s", 1e9)})
    (ramp,) = bench.go(f"{RAMP}, timeout_min: 0.1")
    assert ramp.outcome == "timeout"
    assert "chamber air is" in ramp.reason


def test_a_held_ramp_stays_where_it_is_and_goes_on_as_a_marked_segment():
    low, fine = (lambda bench: setattr(bench, "disk_mb", 1.0)), (lambda bench: setattr(bench, "disk_mb", 1e6))
    bench = FakeBench(hold_guard(below=10.0), hooks={100: low, 160: fine})
    held, resumed = bench.go(RAMP)
    assert (held.outcome, held.to_s) == ("held", 100.0)
    assert (resumed.name, resumed.outcome) == (f"{held.name} (resumed)", "done")
    assert resumed.from_s == pytest.approx(166.0, abs=2)  # 5 s of release delay
    waiting = [command for command in bench.chamber.commands if held.to_s <= command[0] < resumed.from_s]
    assert len(waiting) == 1
    assert bench.chamber.commands[-1][1:] == (33.0, 2.0)  # from here to the target: nothing is run again
    assert 25.0 < waiting[0][1] < 27.0
    assert "hold" in bench.kinds()


def test_a_guard_that_aborts_ends_the_run_and_keeps_the_segment():
    bench = FakeBench(
        GuardSettings(name="disk", signal="disk_free_mb", below=10.0),
        hooks={50: lambda bench: setattr(bench, "disk_mb", 1.0)},
    )
    with pytest.raises(RunAborted, match="aborted by guard: disk: disk_free_mb = 1 is below 10"):
        bench.go(RAMP)
    (ramp,) = bench.sequencer.results
    assert ramp.outcome == "interrupted"
    assert "disk_free_mb" in ramp.reason


@pytest.mark.parametrize("action", ["abort", "hold"])
@pytest.mark.parametrize("delay_s", [0.0, 600.0])
def test_a_guard_that_objects_before_the_start_leaves_everything_untouched(action, delay_s):
    bench = FakeBench(GuardSettings(name="d", signal="disk_free_mb", below=10.0, action=action, delay_s=delay_s))
    bench.disk_mb = 1.0
    with pytest.raises(RunAborted, match="not started: d: disk_free_mb = 1 is below 10"):
        bench.go(RAMP)
    assert bench.chamber.commands == []
    assert not bench.sequencer.moved


def test_a_unit_that_is_not_there_ends_it_before_anything_moves():
    bench = FakeBench()
    bench.missing = 1000
    with pytest.raises(EquipmentError, match="not started: unit X: no sound rate frame"):
        bench.go(RAMP)
    assert bench.clock.now() == 10.0
    assert bench.chamber.commands == []


def test_a_stop_request_ends_the_run_at_the_next_tick():
    bench = FakeBench(hooks={60: lambda bench: bench.sequencer.request_stop("operator")})
    with pytest.raises(RunAborted, match="aborted by operator"):
        bench.go(RAMP)
    assert bench.clock.now() == 61.0


def test_a_stop_request_is_heard_while_the_units_are_awaited():
    bench = FakeBench(hooks={2: lambda bench: bench.sequencer.request_stop("operator")})
    bench.missing = 1000
    with pytest.raises(RunAborted, match="operator"):
        bench.go(RAMP)
    assert bench.clock.now() == 3.0


LINK = LinkSettings(degraded_after_s=5.0, lost_after_s=30.0, retry_most_s=8.0)


def link_events(bench):
    return [(t_s, text) for t_s, kind, text in bench.events if kind == "link"]


def test_a_short_outage_of_the_chamber_is_two_events_and_no_more():
    bench = FakeBench(link=LINK)
    bench.chamber.faults[50, 52] = LinkError("no answer")
    (ramp,) = bench.go(RAMP)
    assert ramp.outcome == "done"
    assert link_events(bench) == [
        (50.0, "chamber does not answer: no answer"),
        (53.0, "chamber answers again after 3.0 s and 2 attempts; fake, set point and mode are ours"),
    ]
    assert bench.chamber.identified == [53.0]


def test_a_longer_outage_degrades_the_link_is_probed_more_and_more_seldom_and_the_run_goes_on():
    bench = FakeBench(link=LINK)
    bench.chamber.faults[50, 66] = LinkError("no answer")
    probes = []
    poll = bench.chamber.poll
    bench.chamber.poll = lambda: probes.append(bench.clock.now()) or poll()
    (ramp,) = bench.go(RAMP)
    assert ramp.outcome == "done"
    assert [t_s for t_s in probes if 49 < t_s < 73] == [50, 51, 53, 57, 65]
    assert [text.split(":")[0] for _, text in link_events(bench)][1] == "chamber degraded"
    assert "after 23.0 s and 5 attempts" in link_events(bench)[-1][1]


def test_a_lost_link_is_a_failure_of_the_equipment_but_not_before_it_was_asked_once_more():
    bench = FakeBench(link=LINK)
    bench.chamber.faults[50, 1e9] = LinkError("no answer")
    with pytest.raises(EquipmentError, match="chamber link lost for 30 s: no answer"):
        bench.go(RAMP)
    assert bench.clock.now() == 80.0
    assert [text.split(":")[0] for _, text in link_events(bench)] == [
        "chamber does not answer",
        "chamber degraded",
        "chamber lost",
    ]


def test_a_return_ends_the_run_where_the_station_says_so():
    bench = FakeBench(link=LINK.model_copy(update={"on_return": "abort"}))
    bench.chamber.faults[50, 60] = LinkError("no answer")
    with pytest.raises(EquipmentError, match=r"answers again after 15\.0 s .* on_return: abort"):
        bench.go(RAMP)


def test_a_chamber_that_changed_while_it_was_away_is_an_override():
    bench = FakeBench(OVERRIDE, link=LINK)
    bench.chamber.faults[50, 52] = LinkError("no answer")
    bench.chamber.odd = ["mode is manual, the bench commanded auto"]
    with pytest.raises(RunAborted, match=r"operator override: override = 1 is above 0\.5: mode is manual"):
        bench.go(RAMP)


def test_a_stepped_ramp_does_not_jump_after_an_outage():
    bench = FakeBench(native_ramp=False, link=LINK)
    bench.chamber.deaf = (50.0, 66.0)
    (ramp,) = bench.go(RAMP)
    assert ramp.outcome == "done"
    targets = [target for _, target, _ in bench.chamber.commands[2:]]
    steps = [after - before for before, after in pairwise(targets)]
    assert max(steps) <= 5 * 2 / 60 + 1e-9
    assert min(steps) >= 0


def test_a_command_whose_confirmation_was_lost_is_ours_all_the_same():
    bench = FakeBench(OVERRIDE, link=LINK)
    bench.chamber.unconfirmed = True
    (ramp, soak) = bench.go(RAMP, "kind: soak, duration_min: 1")
    assert (ramp.outcome, soak.outcome) == ("done", "done")
    assert "guard" not in bench.kinds()


def test_old_readings_neither_arrive_nor_settle():
    bench = FakeBench(link=LINK)
    bench.chamber.faults[100, 126] = LinkError("no answer")
    settle = "settle: {dwell_min: 0.1, band_degc: 20, unit_band_degc: 20, slope_degc_per_min: 50}"
    step = f"kind: step, temperatures_degc: [25], average_min: 1, {settle}"
    _, move, _ = bench.go("kind: soak, duration_min: 1.6", step)
    assert move.outcome == "done"
    settled_s = next(t_s for t_s, kind, _ in bench.events if kind == "settled")
    assert settled_s > 126.0


def test_a_reading_that_cannot_be_true_reaches_the_runner():
    bench = FakeBench()
    bench.chamber.faults[50, 51] = LimitError("temperature reads nan")
    with pytest.raises(LimitError):
        bench.go(RAMP)
    assert bench.sequencer.results[-1].outcome == "interrupted"


def test_a_set_point_of_somebody_else_trips_a_guard():
    bench = FakeBench(OVERRIDE, hooks={50: lambda bench: setattr(bench.chamber, "panel", 60.0)})
    with pytest.raises(RunAborted, match=r"override = 1 .*: set point is 60 degC, the bench commanded 33"):
        bench.go(RAMP)
    assert bench.clock.now() == 54.0


def test_a_chamber_that_somebody_switched_off_trips_it_too():
    bench = FakeBench(OVERRIDE, hooks={50: lambda bench: setattr(bench.chamber, "on", False)})
    with pytest.raises(RunAborted, match="the chamber has been off for 14 s although the run is on"):
        bench.go(RAMP)


def test_an_operator_holds_a_ramp_where_it_is_and_resumes_it_without_rewinding():
    hold = lambda bench: bench.sequencer.request_hold("operator ada")  # noqa: E731
    resume = lambda bench: bench.sequencer.request_resume("operator ben")  # noqa: E731
    bench = FakeBench(hooks={100: hold, 160: resume})
    held, resumed = bench.go(RAMP)
    assert (held.outcome, held.to_s) == ("held", 101.0)
    assert held.reason == "operator: hold by operator ada"
    assert (resumed.name, resumed.from_s, resumed.outcome) == (f"{held.name} (resumed)", 161.0, "done")
    asked = [text for _, kind, text in bench.events if kind == "request"]
    assert asked == ["hold by operator ada", "resume by operator ben"]
    states = [status.state for status in bench.seen if 101 <= status.t_s <= 161]
    assert set(states[:-1]) == {"holding"}
    targets = [target for _, target, _ in bench.chamber.commands[2:]]
    assert targets == [33.0, pytest.approx(26, abs=1), 33.0]
    assert bench.readings == len(bench.seen) + 1  # every second of the hold is recorded


def test_the_forecast_stays_true_through_a_hold():
    hold = lambda bench: bench.sequencer.request_hold("operator")  # noqa: E731
    resume = lambda bench: bench.sequencer.request_resume("operator")  # noqa: E731
    bench = FakeBench(hooks={100: hold, 400: resume})
    results = bench.go(RAMP, "kind: soak, duration_min: 5")
    nominal_s = bench.seen[0].leg.nominal_end_s + 300.0
    ends = {status.t_s: status.t_s + time_left(status, nominal_s)[1] for status in bench.seen}
    during = [end_s - t_s for t_s, end_s in ends.items() if 110 < t_s < 390]
    assert max(during) - min(during) <= 1.0, "a hold takes nothing of what is left"
    assert ends[450.0] == pytest.approx(results[-1].to_s, abs=30.0)


def test_a_pause_waits_for_the_end_of_the_segment_and_holds_its_target():
    bench = FakeBench(
        hooks={
            50: lambda bench: bench.sequencer.request_pause("operator"),
            500: lambda bench: bench.sequencer.request_resume("operator"),
        }
    )
    ramp, soak = bench.go(RAMP, "kind: soak, duration_min: 1")
    assert ramp.outcome == "done"
    assert soak.from_s == pytest.approx(501.0, abs=1)
    assert {status.state for status in bench.seen if 52 < status.t_s < ramp.to_s} == {"pausing"}
    assert {target for t_s, target, _ in bench.chamber.commands if t_s > ramp.from_s} == {33.0}


def test_resume_does_not_release_what_a_guard_holds():
    low, fine = (lambda bench: setattr(bench, "disk_mb", 1.0)), (lambda bench: setattr(bench, "disk_mb", 1e6))
    resume = lambda bench: bench.sequencer.request_resume("operator")  # noqa: E731
    bench = FakeBench(hold_guard(below=10.0), hooks={100: low, 120: resume, 160: fine})
    _, resumed = bench.go(RAMP)
    assert resumed.from_s > 160.0


def test_stop_ends_a_hold():
    bench = FakeBench(
        hooks={
            50: lambda bench: bench.sequencer.request_hold("operator"),
            90: lambda bench: bench.sequencer.request_stop("operator"),
        }
    )
    with pytest.raises(RunAborted, match="aborted by operator"):
        bench.go(RAMP)
    assert bench.clock.now() == 91.0


COLD = "kind: ramp, to_degc: -10, rate_degc_per_min: 5"


def test_a_profile_that_ends_cold_returns_to_ambient_and_records_the_way():
    bench = FakeBench()
    cold, home = bench.go(COLD)
    assert (home.name, home.kind, home.outcome, home.target_degc) == ("return to ambient", "ramp", "done", 23.0)
    assert 18.0 <= bench.chamber.air < 18.5
    assert bench.seen[-1].legs == 2
    assert home.from_s == cold.to_s


def test_the_way_back_waits_for_units_that_are_still_cold():
    bench = FakeBench(hooks={700: lambda bench: setattr(bench, "lag_degc", 0.0)})
    bench.lag_degc = -20.0
    _, _, home = bench.go(COLD, "kind: soak, duration_min: 1")
    assert (home.outcome, home.to_s > 700.0) == ("done", True)


def test_a_profile_that_ends_warm_is_over():
    assert len(FakeBench().go(RAMP)) == 1


def test_the_way_back_has_a_time_limit():
    bench = FakeBench(hooks={600: lambda bench: setattr(bench.chamber, "tau_s", 1e9)})
    _, home = bench.go(COLD, "kind: soak, duration_min: 5")[-2:]
    assert (home.outcome, home.to_s - home.from_s) == ("timeout", pytest.approx(3600, abs=2))


def test_a_safe_guard_ends_the_profile_and_records_the_way_to_ambient():
    guard = GuardSettings(name="disk", signal="disk_free_mb", below=10.0, action="safe")
    bench = FakeBench(guard, hooks={400: lambda bench: setattr(bench, "disk_mb", 1.0)})
    with pytest.raises(RunAborted, match=r"profile ended by guard: disk: .*; the chamber is back at ambient"):
        bench.go("kind: ramp, to_degc: 80, rate_degc_per_min: 5", "kind: soak, duration_min: 5")
    up, home = bench.sequencer.results
    assert (up.outcome, home.outcome, home.target_degc) == ("interrupted", "done", 23.0)
    assert bench.chamber.air < 28.0


def test_rates_are_turned_once_settled_and_the_table_stops_with_the_leg():
    told = []

    class Turning:
        def tick(self, now_s, settled):
            told.append(settled)
            return len(told) >= 100

        def stop(self):
            told.append("stop")

    class Still:
        def tick(self, now_s, settled):
            return True

        def stop(self):
            pass

    class Table:
        def begin(self, leg):
            return Turning() if leg.kind == "soak" else Still()

    bench = FakeBench(table=Table())
    _, soak = bench.go(RAMP, "kind: soak, duration_min: 1")
    assert soak.to_s - soak.from_s == 100.0
    assert told == [*[True] * 100, "stop"]


def test_the_onlooker_sees_every_tick_of_every_leg():
    bench = FakeBench()
    ramp, soak = bench.go(RAMP, "kind: soak, duration_min: 1")
    assert [status.t_s for status in bench.seen] == [ramp.from_s + 1 + i for i in range(int(soak.to_s - ramp.from_s))]
    assert bench.seen[-1].legs == 2
    assert bench.readings == len(bench.seen) + 1  # and one before the start


def test_ticks_keep_their_second_however_long_the_work_takes():
    bench = FakeBench(hooks={20: lambda bench: bench.clock.sleep_until(20.4), 25: lambda b: b.clock.sleep_until(28.3)})
    bench.go("kind: soak, duration_min: 1")
    times = [status.t_s for status in bench.seen]
    assert [t for t in times if 20 < t < 32] == [20.4, 21.0, 22.0, 23.0, 24.0, 28.3, 28.3, 29.3, 30.3, 31.3]


class Satisfied:
    """Has seen enough at a bench time."""

    def __init__(self, at_s):
        self.at_s, self.asked = at_s, 0

    def decide(self, status):
        self.asked += 1
        return Stop("the coefficients are good enough", who="fit") if status.t_s >= self.at_s else Continue()


def test_who_is_asked_whether_the_run_goes_on_may_end_it_and_is_named():
    decider = Satisfied(40.0)
    bench = FakeBench(decider=decider)
    (ramp,) = bench.go(RAMP, "kind: soak, duration_min: 1")
    said = "ended early by fit: the coefficients are good enough"
    assert (ramp.outcome, ramp.reason, ramp.to_s) == ("ended", said, 40.0)
    assert [text for _, kind, text in bench.events if kind == "decision"] == [said]
    assert (str(bench.sequencer.decision), decider.asked) == (said, len(bench.seen))


def test_a_run_that_is_ended_early_while_it_is_cold_goes_home_first_and_asks_nobody_on_the_way():
    decider = Satisfied(1500.0)
    bench = FakeBench(decider=decider)
    *_, home = bench.go("kind: ramp, to_degc: -10, rate_degc_per_min: 2", "kind: soak, duration_min: 60")
    assert (home.name, home.outcome) == ("return to ambient", "done")
    assert home.from_s == 1500.0
    assert decider.asked == len([status for status in bench.seen if status.leg.name != home.name])


def test_a_run_that_is_held_can_be_ended_early():
    bench = FakeBench(decider=Satisfied(100.0), hooks={30: lambda bench: bench.sequencer.request_hold("me")})
    held = bench.go(RAMP)
    assert [result.outcome for result in held] == ["held"]
    assert bench.sequencer.decision.who == "fit"
