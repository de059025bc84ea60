import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid, solve_ivp

from bench.analysis.effects.operators import integral, latch, play, ramp_invariant_lag, uneven_lag


def triangle(time_s):
    return 85.0 - np.abs((time_s / 60.0) % 250.0 - 125.0)


@pytest.mark.parametrize("spacing", ["even", "uneven"])
def test_lag_solves_its_equation_for_a_record_straight_between_samples(spacing):
    rng = np.random.default_rng(0)
    time_s = np.arange(200) * 30.0 if spacing == "even" else np.cumsum(rng.uniform(5.0, 90.0, 200))
    value = np.cumsum(rng.normal(size=200))
    solution = solve_ivp(
        lambda t, x: (np.interp(t, time_s, value) - x) / 240.0,
        (time_s[0], time_s[-1]),
        value[:1],
        t_eval=time_s,
        max_step=5.0,
        rtol=1e-8,
    )
    assert_allclose(ramp_invariant_lag(time_s, value, 240.0), solution.y[0], atol=2e-3)


def test_lag_behind_a_ramp_is_slope_times_tau_whatever_the_sampling():
    for step_s in (1.0, 30.0, 300.0):
        time_s = np.arange(0.0, 6001.0, step_s)
        assert_allclose(ramp_invariant_lag(time_s, 0.02 * time_s, 200.0)[-1], 0.02 * (6000.0 - 200.0), rtol=1e-9)


def test_a_lag_whose_time_constant_changes_solves_its_equation_too():
    time_s = np.arange(300) * 30.0
    value, tau_s = triangle(time_s), 300.0 * np.exp(-0.02 * (triangle(time_s) - 25.0))
    tau_s[100] = np.nan  # of a gap: the straight line between its neighbours
    known = np.isfinite(tau_s)
    solution = solve_ivp(
        lambda t, x: (np.interp(t, time_s, value) - x) / np.interp(t, time_s[known], tau_s[known]),
        (0.0, time_s[-1]), value[:1], t_eval=time_s, max_step=5.0, rtol=1e-8,
    )  # fmt: skip
    assert_allclose(ramp_invariant_lag(time_s, value, tau_s), solution.y[0], atol=2e-3)


@pytest.mark.parametrize(("rise_s", "fall_s"), [(200.0, 3000.0), (3000.0, 200.0)])
def test_an_uneven_lag_solves_its_equation_with_one_time_constant_above_and_another_below(rise_s, fall_s):
    time_s = np.cumsum(np.random.default_rng(2).uniform(5.0, 90.0, 400))
    value = triangle(time_s)

    def slope(t, x):
        ahead = np.interp(t, time_s, value) - x
        return ahead / np.where(ahead > 0.0, rise_s, fall_s)

    solution = solve_ivp(slope, (time_s[0], time_s[-1]), value[:1], t_eval=time_s, max_step=5.0, rtol=1e-8)
    assert_allclose(uneven_lag(time_s, value, rise_s, fall_s), solution.y[0], atol=2e-3)
    assert_allclose(uneven_lag(time_s, value, 500.0, 500.0), ramp_invariant_lag(time_s, value, 500.0), atol=1e-9)


def test_an_integral_begins_with_the_run_and_bridges_a_gap():
    time_s = np.cumsum(np.random.default_rng(1).uniform(5.0, 90.0, 50))
    value = triangle(time_s)
    assert_allclose(integral(time_s, value), cumulative_trapezoid(value, time_s, initial=0.0))
    value[20] = np.nan
    whole = np.delete(np.arange(50), 20)
    assert_allclose(integral(time_s, value)[whole], cumulative_trapezoid(value[whole], time_s[whole], initial=0.0))
    assert np.isnan(integral(time_s, value)[20])


def test_no_lag_returns_the_record():
    value = np.array([1.0, 5.0, 2.0])
    assert_allclose(ramp_invariant_lag(np.arange(3.0), value, 0.0), value)


def test_play_lags_by_its_half_width_whatever_the_rate():
    time_s = np.arange(0.0, 30000.0, 30.0)
    for speed in (1, 3):
        value = triangle(time_s * speed)
        gap = value - play(value, 4.0)
        rising = np.gradient(value) > 0
        assert_allclose(np.quantile(gap[rising], 0.9), 4.0)
        assert_allclose(np.quantile(gap[~rising], 0.1), -4.0)


def test_play_stands_still_inside_its_width_and_forgets_the_route():
    assert_allclose(play(np.array([0.0, 1.0, -1.0, 0.5]), 2.0), 0.0)
    assert_allclose(play(np.array([0.0, 5.0, 3.0, 7.0]), 2.0), play(np.array([0.0, 5.0, 5.0, 7.0]), 2.0))


@pytest.mark.parametrize(("high", "low"), [(60.0, -10.0), (-10.0, 60.0), (20.0, 20.0)])
def test_a_latch_is_set_above_one_value_and_let_go_below_another(high, low):
    value = np.cumsum(np.random.default_rng(2).normal(scale=8.0, size=400)) + 25.0
    value[77] = np.nan
    found = latch(value, high, low)
    state = 1.0 if value[0] > 0.5 * (high + low) else 0.0
    for row, each in enumerate(value.tolist()):
        if row == 77:
            assert np.isnan(found[row])
            continue
        state = 1.0 if each > max(high, low) else 0.0 if each < min(high, low) else state
        assert found[row] == state
