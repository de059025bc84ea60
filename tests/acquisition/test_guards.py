"""Guards: thresholds, hysteresis, delays, rates, and silence that is never good news."""

import math

import pytest
from pydantic import ValidationError

from bench.acquisition.profile.guards import OPTIONAL, Guards, GuardSettings, Signal, guards_of
from bench.base.errors import InputError


def guard(**settings):
    return GuardSettings(**{"name": "g", "signal": "chamber_temperature", "max_age_s": 5.0, **settings})


def trips(settings, values):
    """(time, tripped) of every change when the signal takes these values once a second; None: missing."""
    guards, found = Guards([settings]), []
    for t_s, value in enumerate(values):
        signals = {} if value is None else {settings.signal: Signal(value, float(t_s))}
        found += [(t_s, trip.tripped) for trip in guards.evaluate(signals, float(t_s))]
    return found


def test_trips_beyond_its_threshold_and_not_at_it():
    assert trips(guard(above=85.0), [84.0, 85.0, 85.1]) == [(2, True)]
    assert trips(guard(below=-40.0), [-39.0, -40.0, -40.1]) == [(2, True)]


def test_trips_only_when_the_trouble_has_lasted_for_its_delay():
    rule = guard(above=85.0, delay_s=3.0)
    assert trips(rule, [90, 90, 90, 90]) == [(3, True)]
    assert trips(rule, [90, 90, 80, 90, 90, 90]) == []


def test_releases_beyond_the_release_threshold_for_the_release_delay():
    rule = guard(above=85.0, release_below=80.0, release_delay_s=2.0)
    assert trips(rule, [86, 82, 82, 82, 82, 82]) == [(0, True)]  # inside the limit, but not released
    assert trips(rule, [86, 79, 79, 82, 79, 79, 79]) == [(0, True), (6, False)]


def test_trips_again_after_a_release():
    rule = guard(above=85.0, release_delay_s=0.0)
    assert trips(rule, [86, 80, 86]) == [(0, True), (1, False), (2, True)]


@pytest.mark.parametrize("value", [None, math.nan])
def test_a_missing_signal_trips_at_once_whatever_the_delay(value):
    assert trips(guard(above=85.0, delay_s=60.0), [20.0, value]) == [(1, True)]


def test_a_stale_signal_trips_when_it_is_older_than_allowed():
    guards = Guards([guard(above=85.0, delay_s=60.0)])
    old = {"chamber_temperature": Signal(20.0, 0.0)}
    assert guards.evaluate(old, 5.0) == []
    (trip,) = guards.evaluate(old, 5.1)
    assert trip.text == "g: chamber air temperature is 5.1 s old, 5 s allowed"


def test_infinity_is_beyond_any_threshold():
    assert trips(guard(above=85.0), [math.inf]) == [(0, True)]


def test_rate_trips_on_a_fast_change_in_either_direction_and_not_on_a_slow_one():
    rule = guard(rate_per_min=6.0, rate_over_s=10.0)
    assert trips(rule, [20 + 0.09 * t for t in range(60)]) == []
    assert trips(rule, [20 - 0.2 * t for t in range(60)])[0] == (6, True)  # 1 degC within the 10 s
    assert trips(rule, [20.0] * 30 + [22.0] * 30)[0] == (30, True)


def test_the_light_of_a_guard_of_a_rate_shows_the_rate():
    guards = Guards([guard(rate_per_min=6.0, rate_over_s=10.0), guard(name="h", above=85.0, rate_per_min=6.0)])
    for t_s in range(20):
        guards.evaluate({"chamber_temperature": Signal(20.0 + 0.05 * t_s, float(t_s))}, float(t_s))
    slow, hot = guards.lights()
    assert (slow.per_min, hot.per_min) == (pytest.approx(3.0), None)


def test_rate_does_not_trip_on_the_last_digit_of_the_sensor():
    assert trips(guard(rate_per_min=1.0), [20 + 0.1 * (t % 2) for t in range(60)]) == []


def test_rate_trips_and_releases_when_the_change_is_over():
    rule = guard(rate_per_min=6.0, rate_over_s=10.0, release_delay_s=5.0)
    assert trips(rule, [20.0] * 10 + [25.0] * 40) == [(10, True), (25, False)]


def test_troubles_are_named_before_their_delay_is_over():
    guards = Guards([guard(above=85.0, delay_s=60.0)])
    guards.evaluate({"chamber_temperature": Signal(90.0, 0.0)}, 0.0)
    assert guards.troubles() == ["g: chamber air temperature = 90 degC is above 85 degC"]
    assert guards.in_force("abort") == []


ALL_TOLD = {"power", "frozen_s", "door", "sensor_break"}


def test_every_run_is_guarded_against_what_would_spoil_it():
    always = {rule.signal: rule.action for rule in guards_of((), (), ())}
    assert always == dict.fromkeys(["frame_age", "alarm", "override", "disk_free_mb"], "abort")
    told = {rule.signal: rule.action for rule in guards_of((), (), ALL_TOLD)}
    assert told == always | {"frozen_s": "abort", "sensor_break": "abort", "door": "hold"}


def test_a_guard_of_the_station_takes_the_place_of_the_one_with_its_name():
    mine = GuardSettings(name="unit silent", signal="frame_age", above=2.0, action="hold")
    assert [rule for rule in guards_of((mine,), (), ()) if rule.signal == "frame_age"] == [mine]
    assert len([rule for rule in guards_of((), (mine,), ()) if rule.signal == "frame_age"]) == 2  # a profile adds


@pytest.mark.parametrize("signal", sorted(OPTIONAL))
@pytest.mark.parametrize("where", ["station", "profile"])
def test_a_guard_on_what_the_controller_never_tells_is_refused(signal, where):
    rule = GuardSettings(name="mine", signal=signal, above=0.5)
    groups = {"station": ((rule,), ()), "profile": ((), (rule,))}
    with pytest.raises(InputError, match=f"guard 'mine' watches {signal}, which nothing of this station tells; remove"):
        guards_of(*groups[where], ALL_TOLD - {signal})
    assert rule in guards_of(*groups[where], {signal})


def test_the_guards_of_every_run_leave_a_silent_chamber_to_its_link():
    waits = {rule.signal: rule.max_age_s for rule in guards_of((), (), (), patience_s=300.0)}
    assert (waits["alarm"], waits["override"]) == (300.0, 300.0)


def test_what_stands_behind_a_number_is_said():
    guards = Guards([guard(above=0.5, signal="alarm")])
    (trip,) = guards.evaluate({"alarm": Signal(1.0, 0.0, "alarm_1: latched")}, 0.0)
    assert trip.text == "g: alarm: alarm_1: latched"


@pytest.mark.parametrize(
    ("name", "said"),
    [("door open", ["door open: yes", "door open: no"]), ("g", ["g: door open: yes", "g: door open: no"])],
)
def test_what_is_yes_or_no_is_told_without_numbers_and_once(name, said):
    guards = Guards([guard(name=name, above=0.5, signal="door", release_delay_s=0.0)])
    trips = [trip.text for t_s in (0.0, 1.0) for trip in guards.evaluate({"door": Signal(1.0 - t_s, t_s)}, t_s)]
    assert trips == said


def test_guards_in_force_are_listed_for_each_action():
    rules = [guard(name=action, above=1.0, action=action) for action in ("hold", "safe", "abort")]
    guards = Guards(rules)
    guards.evaluate({"chamber_temperature": Signal(3.0, 0.0)}, 0.0)
    for action in ("hold", "safe", "abort"):
        assert guards.in_force(action) == [f"{action}: chamber air temperature = 3 degC is above 1 degC"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "at least one of above, below, rate_per_min"),
        ({"above": 80.0, "release_below": 81.0}, "release_below .81. lies beyond above .80."),
        ({"below": 0.0, "release_above": -1.0}, "release_above .-1. lies beyond below .0."),
        ({"below": 0.0, "release_below": 1.0}, "release_below has no effect without `above`"),
        ({"above": math.nan}, "finite"),
        ({"above": 1.0, "signal": "chamber_temprature"}, "Input should be"),
        ({"above": 1.0, "dealy_s": 1.0}, "Extra inputs"),
    ],
)
def test_a_guard_that_could_never_trip_is_refused(settings, message):
    with pytest.raises(ValidationError, match=message):
        guard(**settings)
