"""Effects of a thermometer that is wrong: each undoes what a sensor of that kind did, computed another way."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

from bench.analysis.effects import registry as effects
from bench.analysis.effects.operators import play
from bench.record.dataset import Dataset


def record(time_s, **channels):
    channels = {"rate": np.zeros(time_s.size), **channels}
    return Dataset("made", time_s, channels, np.zeros(time_s.size, dtype=np.int64), (), float(time_s[1] - time_s[0]))


TIME = np.arange(0.0, 6 * 3600.0, 1.0)
TRUE = 20.0 + 30.0 * np.sin(TIME / 2400.0) + 0.5 * np.sin(TIME / 700.0)
INSIDE = slice(2000, -2000)


@pytest.mark.parametrize("tau_s", [20.0, 300.0])
def test_the_lead_undoes_a_resistance_and_a_capacity(tau_s):
    """The thermometer as scipy's state space solves it."""
    system = scipy.signal.StateSpace([[-1.0 / tau_s]], [[1.0 / tau_s]], [[1.0]], [[0.0]])
    _, shown, _ = scipy.signal.lsim(system, TRUE - TRUE[0], TIME)
    data = record(TIME, temperature=shown + TRUE[0])
    found = effects.make("thermometer_lag").abscissa(data, {"tau_s": tau_s})
    assert_allclose(found[INSIDE], TRUE[INSIDE], atol=0.02 * np.abs(shown + TRUE[0] - TRUE)[INSIDE].max())


@pytest.mark.parametrize(("late", "sign"), [("rate", -1.0), ("temperature", 1.0)])
def test_a_delay_of_either_channel_is_undone(late, sign):
    data = record(TIME, temperature=TRUE)
    found = effects.make("clock_delay", {"late": late}).abscissa(data, {"delay_s": 45.0})
    assert_allclose(found[INSIDE], np.interp(TIME + sign * 45.0, TIME, TRUE)[INSIDE], atol=1e-9)


@pytest.mark.parametrize(("reads", "sign"), [("low", 1.0), ("high", -1.0)])
def test_a_loop_of_the_thermometer_moves_both_branches_apart(reads, sign):
    data = record(TIME, temperature=TRUE)
    effect = effects.make("thermometer_hysteresis", {"reads": reads})
    moved = effect.abscissa(data, {"opening_degc": 0.4, "width_degc": 3.0}) - TRUE
    slope, later = np.gradient(TRUE), TIME > 4000.0
    middle = later & (np.abs(TRUE - 20.0) < 10.0)
    assert_allclose(moved[middle & (slope > 0)], sign * 0.4, atol=1e-9)
    assert_allclose(moved[middle & (slope < 0)], -sign * 0.4, atol=1e-9)


def test_one_of_the_loops_undoes_a_backlash_which_closes_at_once_after_each_turn():
    data = record(TIME, temperature=play(TRUE, 0.5))
    shapes = effects.make("thermometer_hysteresis").shapes()
    left = [np.std(shape.abscissa(data, {"opening_degc": 0.5}) - TRUE) for shape in shapes]
    assert min(left) < 0.35 * np.std(data.channel("temperature") - TRUE)


def test_an_offset_grows_with_time_or_follows_the_air():
    data = record(TIME, temperature=TRUE, chamber_temperature=TRUE + 5.0)
    drift = effects.make("thermometer_offset").abscissa(data, {"drift_degc_per_h": 0.2})
    assert_allclose(drift - TRUE, 0.2 * TIME / 3600.0, atol=1e-12)
    slower = effects.make("thermometer_offset", {"over": "root"}).abscissa(data, {"drift_degc_per_h": 0.2})
    assert_allclose(slower - TRUE, 0.2 * np.sqrt(TIME / 3600.0), atol=1e-12)
    high = effects.make("thermometer_offset", {"over": "air", "reads": "high"})
    assert_allclose(high.abscissa(data, {"share": 0.1}) - TRUE, -0.5, atol=1e-12)
    assert high.needs == ("temperature", "chamber_temperature")
