"""The sequencer on a fake station in simulated time: ramps, holds, timeouts, lost links, two masters."""

from itertools import pairwise
from types import SimpleNamespace

import pytest

from bench.acquisition.profile.guards import DEFAULT_GUARDS, GuardSettings
from bench.acquisition.run.control import time_left
from bench.acquisition.run.wiring import Continue, Stop
from bench.acquisition.station.settings.link import LinkSettings
from bench.base.errors import EquipmentError, RunAborted
from drivers.errors import LimitError, LinkError
from tests.support.fake_bench import FakeBench

RAMP = "kind: ramp, to_degc: 33, rate_degc_per_min: 2"


OVERRIDE = next(guard for guard in DEFAULT_GUARDS if guard.signal == "override")


LOW = {"name": "disk", "signal": "disk_free_mb", "below": 10.0}
HOLD = GuardSettings(**LOW, action="hold", release_delay_s=5.0)


def asks(request, who="operator"):
    """At its time, somebody asks for a hold, a pause, its end, or the end of the run."""
    return lambda bench: getattr(bench.sequencer, f"request_{request}")(who)


def disk(free_mb):
    """From its time, so much of the disk is free."""
    return lambda bench: setattr(bench, "disk_mb", free_mb)


def stuck(bench):
    """From now, the air does not move."""
    bench.chamber.tau_s = 1e9


def test_a_ramp_is_commanded_once_and_ends_when_the_air_has_arrived():
    bench = FakeBench()
    (ramp,) = bench.go(RAMP)
    assert bench.chamber.commands[2:] == [(ramp.from_s, 33.0, 2.0)]
    assert ramp.outcome == "done"  # a profile that ends warm is over: there is no way back to ambient
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
    bench = FakeBench(hooks={10: stuck})
    (ramp,) = bench.go(f"{RAMP}, timeout_min: 0.1")
    assert ramp.outcome == "timeout"
    assert "chamber air is" in ramp.reason


def test_a_held_ramp_stays_where_it_is_and_goes_on_as_a_marked_segment():
    bench = FakeBench(HOLD, hooks={100: disk(1.0), 160: disk(1e6)})
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
    bench = FakeBench(GuardSettings(**LOW), hooks={50: disk(1.0)})
    with pytest.raises(RunAborted, match="aborted by guard: disk: free space of the disk = 1 MB is below 10 MB"):
        bench.go(RAMP)
    (ramp,) = bench.sequencer.results
    assert ramp.outcome == "interrupted"
    assert "free space of the disk" in ramp.reason


@pytest.mark.parametrize("action", ["abort", "hold"])
@pytest.mark.parametrize("delay_s", [0.0, 600.0])
def test_a_guard_that_objects_before_the_start_leaves_everything_untouched(action, delay_s):
    bench = FakeBench(GuardSettings(**LOW, action=action, delay_s=delay_s))
    bench.disk_mb = 1.0
    with pytest.raises(RunAborted, match="not started: disk: free space of the disk = 1 MB is below 10 MB"):
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


@pytest.mark.parametrize(
    ("at_s", "missing", "before"),
    [(60, 2, {}), (90, 2, {50: asks("hold")}), (2, 1000, {})],
    ids=["in a ramp", "in a hold", "while the units are awaited"],
)
def test_a_stop_request_ends_the_run_at_the_next_tick(at_s, missing, before):
    bench = FakeBench(hooks={**before, at_s: asks("stop")})
    bench.missing = missing
    with pytest.raises(RunAborted, match="aborted by operator"):
        bench.go(RAMP)
    assert bench.clock.now() == at_s + 1.0


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
    with pytest.raises(RunAborted, match="operator override: mode is manual"):
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


@pytest.mark.parametrize(
    ("what", "value", "said", "at_s"),
    [
        ("panel", 60.0, r"override: set point is 60 degC, the bench commanded 33", 54.0),
        ("on", False, "the chamber has been off for 14 s although the run is on", 65.0),
    ],
)
def test_what_somebody_else_does_at_the_panel_trips_a_guard(what, value, said, at_s):
    bench = FakeBench(OVERRIDE, hooks={50: lambda bench: setattr(bench.chamber, what, value)})
    with pytest.raises(RunAborted, match=said):
        bench.go(RAMP)
    assert bench.clock.now() == at_s


def test_an_operator_holds_a_ramp_where_it_is_and_resumes_it_without_rewinding():
    bench = FakeBench(hooks={100: asks("hold", "operator ada"), 160: asks("resume", "operator ben")})
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


def test_a_soak_that_is_held_begins_anew_is_told_before_and_in_the_hold_and_counted_in_the_forecast():
    soaked = "kind: soak, duration_min: 5"
    begins = next(result.from_s for result in FakeBench().go(RAMP, soaked) if result.kind == "soak")
    bench = FakeBench(hooks={begins + 200: asks("hold"), begins + 260: asks("resume")})
    _, held, soak = bench.go(RAMP, soaked)
    assert (held.outcome, soak.outcome, soak.to_s - soak.from_s) == ("held", "done", pytest.approx(300, abs=2))
    told = {status.t_s: (status.state, status.anew) for status in bench.seen}
    assert [told[begins + s] for s in (-50, 100, 230)] == [("running", False), ("running", True), ("holding", True)]
    (left,) = {time_left(status, status.leg.nominal_end_s)[0] for status in bench.seen if status.leg.name == "hold"}
    assert left == pytest.approx(300, abs=2)


def test_the_forecast_stays_true_through_a_hold():
    bench = FakeBench(hooks={100: asks("hold"), 400: asks("resume")})
    results = bench.go(RAMP, "kind: soak, duration_min: 5")
    nominal_s = bench.seen[0].leg.nominal_end_s + 300.0
    ends = {status.t_s: status.t_s + time_left(status, nominal_s)[1] for status in bench.seen}
    during = [end_s - t_s for t_s, end_s in ends.items() if 110 < t_s < 390]
    assert max(during) - min(during) <= 1.0, "a hold takes nothing of what is left"
    assert ends[450.0] == pytest.approx(results[-1].to_s, abs=30.0)


def test_a_pause_waits_for_the_end_of_the_segment_and_holds_its_target():
    bench = FakeBench(hooks={50: asks("pause"), 500: asks("resume")})
    ramp, soak = bench.go(RAMP, "kind: soak, duration_min: 1")
    assert ramp.outcome == "done"
    assert soak.from_s == pytest.approx(501.0, abs=1)
    assert {status.state for status in bench.seen if 52 < status.t_s < ramp.to_s} == {"pausing"}
    assert {target for t_s, target, _ in bench.chamber.commands if t_s > ramp.from_s} == {33.0}


def test_resume_does_not_release_what_a_guard_holds():
    bench = FakeBench(HOLD, hooks={100: disk(1.0), 120: asks("resume"), 160: disk(1e6)})
    _, resumed = bench.go(RAMP)
    assert resumed.from_s > 160.0


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


def test_the_way_back_has_a_time_limit():
    bench = FakeBench(hooks={600: stuck})
    _, home = bench.go(COLD, "kind: soak, duration_min: 5")[-2:]
    assert (home.outcome, home.to_s - home.from_s) == ("timeout", pytest.approx(3600, abs=2))


def test_a_safe_guard_ends_the_profile_and_records_the_way_to_ambient():
    bench = FakeBench(GuardSettings(**LOW, action="safe"), hooks={400: disk(1.0)})
    with pytest.raises(RunAborted, match=r"profile ended by guard: disk: .*; the chamber is back at ambient"):
        bench.go("kind: ramp, to_degc: 80, rate_degc_per_min: 5", "kind: soak, duration_min: 5")
    up, home = bench.sequencer.results
    assert (up.outcome, home.outcome, home.target_degc) == ("interrupted", "done", 23.0)
    assert bench.chamber.air < 28.0


def test_rates_are_turned_once_settled_and_the_table_stops_with_the_leg():
    told = []

    def turn(now_s, settled):
        told.append(settled)
        return len(told) >= 100

    turning = SimpleNamespace(tick=turn, stop=lambda: told.append("stop"))
    still = SimpleNamespace(tick=lambda now_s, settled: True, stop=lambda: None)
    bench = FakeBench(table=SimpleNamespace(begin=lambda leg: turning if leg.kind == "soak" else still))
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
    bench = FakeBench(decider=Satisfied(100.0), hooks={30: asks("hold")})
    held = bench.go(RAMP)
    assert [result.outcome for result in held] == ["held"]
    assert bench.sequencer.decision.who == "fit"
