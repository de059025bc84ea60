"""Charts of stations: run lengths are those of the books, alarms are as rare as stated, and shifts are found."""

import numpy as np
import pytest
from scipy import stats

from bench.archive.fleet.drift import Levelled
from bench.archive.fleet.shifts import ControlChart, alarm, average_run_length, charts_for, latest, shifts, standardised

DAY_S = 86400.0


@pytest.mark.parametrize(
    ("kind", "limit", "shift", "published"),
    [  # D. C. Montgomery, Introduction to Statistical Quality Control, tables of the CUSUM with k = 0.5
        ("cusum", 4.0, 0.0, 168.0), ("cusum", 5.0, 0.0, 465.0), ("cusum", 4.77, 0.0, 370.0),
        ("cusum", 4.0, 1.0, 8.38), ("cusum", 5.0, 1.0, 10.4),
        # Lucas, Saccucci (1990), table 3, weight 0.05
        ("ewma", 2.615, 0.0, 500.0), ("ewma", 2.615, 0.5, 28.8), ("ewma", 2.615, 1.0, 11.4),
    ],
)  # fmt: skip
def test_run_lengths_are_those_of_the_tables(kind, limit, shift, published):
    assert average_run_length(kind, limit, shift) == pytest.approx(published, rel=0.01)


@pytest.mark.parametrize("kind", ["cusum", "ewma"])
def test_a_chart_has_the_run_length_that_was_asked_for_counted_in_values(kind):
    chart = ControlChart.of(kind, 200.0)
    lengths = []
    for seed in range(300):
        found = alarm(np.random.default_rng(seed).normal(size=3000), chart)
        lengths.append(3000 if found is None else found + 1)
    assert np.mean(lengths) == pytest.approx(200.0, abs=3.0 * 200.0 / np.sqrt(300))


def test_values_beside_all_earlier_ones_are_normal_without_a_known_level():
    z = np.concatenate([standardised(np.random.default_rng(seed).normal(7.0, 3.0, 20))[3:] for seed in range(200)])
    assert stats.kstest(z, "norm").pvalue > 0.01
    assert abs(np.corrcoef(z[:-1], z[1:])[0, 1]) < 0.05
    assert not standardised(np.full(9, 2.0)).any()


def fleet(seed, *, shift=0.0, drift=0.0, units=4000, stations=10, lot_sigma=2.0, mixed=True, shape="normal", bad=0.0):
    """Units of spread 1, a lot of 100 after the other; station 3 is off by `shift` from the middle on, or drifts."""
    random = np.random.default_rng(seed)
    days, lot = np.sort(random.uniform(0.0, 100.0, units)), np.arange(units) // 100
    station = random.integers(0, stations, units) if mixed else random.integers(0, stations, lot[-1] + 1)[lot]
    drawn = {"normal": random.normal, "heavy": lambda size: random.standard_t(3, size),
             "skewed": lambda size: random.lognormal(0.0, 1.0, size)}[shape](size=units)  # fmt: skip
    values = drawn + random.normal(0.0, lot_sigma, lot[-1] + 1)[lot] + 0.3 * station
    values = values + np.where(station == 3, np.where(days > 50.0, shift, 0.0) + drift * days / 100.0, 0.0)
    values[1234 % units] += bad
    return Levelled.of(values, days * DAY_S, [f"S{i}" for i in station], [f"L{i:02d}" for i in lot])


def found_in(levelled):
    return list(shifts(levelled, "q", charts_for(levelled.values.size)))


@pytest.mark.parametrize("shape", ["normal", "heavy", "skewed"])
def test_a_fleet_without_a_change_rarely_has_an_alarm(shape):
    alarms = sum(bool(found_in(fleet(seed, shape=shape, mixed=seed % 2 == 0, units=1000))) for seed in range(60))
    assert stats.binomtest(alarms, 60, 0.01, alternative="greater").pvalue > 0.001


@pytest.mark.parametrize("shift", [1.0, -2.0, 8.0])
def test_a_station_that_shifts_is_found_with_its_time_and_size(shift):
    for seed in range(5):
        (one,) = found_in(fleet(seed, shift=shift))
        assert one.place == "S3"
        assert one.before == pytest.approx(200, abs=60)
        assert one.change == pytest.approx(shift, abs=0.7)
        assert one.since < one.row < one.since + 700


@pytest.mark.parametrize("size", [-2.0, 8.0])
def test_a_step_of_a_station_is_told_from_a_drift(size):
    for seed in range(5):
        (step,) = found_in(fleet(seed, shift=size))
        (ramp,) = found_in(fleet(seed, drift=2 * size))
        assert (step.sudden, ramp.sudden) == (True, False)


def test_the_average_says_whether_a_station_is_still_off():
    charts = charts_for(4000)
    now = latest(fleet(1, shift=3.0), charts)
    assert now["S3"] > 1.0
    assert all(abs(now[name]) < 1.0 for name in now if name != "S3")


def test_one_bad_unit_is_no_shift():
    assert found_in(fleet(2, bad=1000.0)) == []
