"""Settled is not reached: band, slope, the unit's own sensor and the dwell time, all of it."""

import math

import pytest

from bench.acquisition.profile.segments import SettleRule
from bench.acquisition.run.settling import Settling

RULE = SettleRule(band_degc=0.5, unit_band_degc=3.0, slope_degc_per_min=0.05, dwell_min=2.0)


def first_settled_s(air, unit, until_s=1000, tick_s=1.0):
    """Bench time at which it settles when air and unit follow two functions of time."""
    settling = Settling(RULE, 50.0)
    for tick in range(int(until_s / tick_s)):
        t_s = tick * tick_s
        if settling.feed(t_s, air(t_s), [unit(t_s)]):
            return t_s
    return settling.reason


def steady(t_s):
    return 50.0


def test_settles_after_the_dwell_time_and_not_before():
    assert first_settled_s(steady, steady) == 120.0


def test_dwell_counts_from_the_last_reading_outside_the_band():
    assert first_settled_s(lambda t: 50.6 if t in (30, 100) else 50.4, steady) == 101 + 120


def test_dwell_is_met_when_ticks_are_late():
    assert first_settled_s(steady, steady, tick_s=7.0) == 126.0


def test_air_in_band_is_not_enough_while_the_unit_is_away():
    assert first_settled_s(steady, lambda t: 46.0) == "unit sensor is 4.00 degC from 50, 3 allowed"


def test_a_unit_that_still_moves_has_not_settled():
    slow, fast = 0.049 / 60, 0.2 / 60
    assert first_settled_s(steady, lambda t: 50.0 + slow * t) == 120.0
    assert "moves by 0.200 degC/min" in first_settled_s(steady, lambda t: 49.0 + fast * t, 400)


def test_a_lagging_unit_settles_when_its_slope_over_the_dwell_is_small():
    tau_s = 300.0
    settled_s = first_settled_s(steady, lambda t: 50.0 - 2.5 * math.exp(-t / tau_s), 3000)
    # slope of the exponential, averaged over the dwell before t, is 0.05 degC/min where this is zero:
    expected_s = tau_s * math.log(2.5 * 60 / tau_s / 0.05 * math.exp(60 / tau_s))
    assert settled_s == pytest.approx(expected_s, abs=5)


@pytest.mark.parametrize(
    ("air", "unit"),
    [
        (lambda t: math.nan, steady),
        (steady, lambda t: math.nan),
        (lambda t: math.nan if t % 100 == 50 else 50.0, steady),
    ],
)
def test_nan_never_settles(air, unit):
    assert isinstance(first_settled_s(air, unit), str)


def test_the_reason_says_how_long_it_has_been_in_band():
    assert first_settled_s(steady, steady, 61) == "in band for 60 s, dwell time is 120 s"


def test_when_a_unit_leaves_the_dwell_time_starts_anew_for_the_others():
    settling = Settling(RULE, 50.0)
    assert not any(settling.feed(float(t), 50.0, [50.0, 50.0]) for t in range(100))
    settled_s = next(t for t in range(100, 400) if settling.feed(float(t), 50.0, [50.0]))
    assert settled_s == 220
