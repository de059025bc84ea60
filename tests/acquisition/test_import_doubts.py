"""What an import doubts or refuses because nothing can have measured it."""

import numpy as np
import pytest

from bench.acquisition.importer.columns import ChannelSource, ColumnMap, TimeSource
from bench.base.errors import InputError
from tests.support.tables import COUNTED, imported, write


def doubts(tmp_path, rate, degc, columns=COUNTED):
    body = "\n".join(f"{r!r},{t!r}" for r, t in zip(rate.tolist(), degc.tolist(), strict=True))
    return imported(write(tmp_path, f"rate,temperature\n{body}\n"), columns).warnings


def test_a_rate_in_another_unit_is_doubted_by_its_magnitude(tmp_path):
    noise, degc = np.random.default_rng(2).normal(5, 3, 500), np.linspace(0, 50, 500)
    assert doubts(tmp_path, noise, degc) == ()
    assert "check the unit" in doubts(tmp_path, noise / 3600, degc)[0]
    assert "check the unit" in doubts(tmp_path, noise / 206265, degc)[0]
    as_rad = ColumnMap(time=TimeSource(interval_s=1), rate=ChannelSource(column="rate", unit="rad/s"))
    assert "more than any gyro measures" in doubts(tmp_path, noise * 1000, degc, as_rad)[0]


def test_doubtful_temperatures_are_warned_of(tmp_path):
    rate = np.random.default_rng(3).normal(5, 3, 500)
    assert "check the unit (K, degF?)" in doubts(tmp_path, rate, np.linspace(250, 320, 500))[0]
    assert "temperature is constant" in doubts(tmp_path, rate, np.full(500, 25.0))[0]
    assert "steps of 1 degC" in doubts(tmp_path, rate, np.round(np.linspace(0, 50, 500)))[0]


def test_an_output_that_hangs_is_warned_of_and_one_in_steps_is_not(tmp_path):
    rng, degc = np.random.default_rng(4), np.linspace(0, 50, 2000)
    rate = rng.normal(5, 3, 2000)
    rate[700:760] = rate[700]
    (said,) = doubts(tmp_path, rate, degc)
    assert "in 60 rows, one after the other, the first 701: did the unit hang?" in said
    rate[700:760] = np.nan
    assert doubts(tmp_path, np.nan_to_num(rate, nan=5.0) + rng.normal(0, 0.1, 2000), degc) == ()
    slow = 5.0 + 0.02 * degc + rng.normal(0, 0.02, 2000)
    assert not any("hang" in text for text in doubts(tmp_path, np.round(slow, 1), degc))


def test_an_output_that_saturates_is_warned_of_and_one_in_steps_is_not(tmp_path):
    rng, degc = np.random.default_rng(4), np.linspace(0, 50, 2000)
    rate = 0.2 * degc + rng.normal(0, 1, 2000)
    (said,) = doubts(tmp_path, np.minimum(rate, 9.5), degc)
    assert said.startswith(f"rate is 9.5 deg/h in {np.count_nonzero(rate > 9.5)} rows and never beyond: does")
    assert doubts(tmp_path, rate, degc) == ()
    held = np.concatenate([rate, np.full(500, rate.max()) + rng.normal(0, 0.2, 500)])
    assert doubts(tmp_path, np.round(held, 1), np.append(degc, np.full(500, 50.0))) == ()


def test_a_thermometer_that_stands_still_and_jumps_is_warned_of_and_one_that_rests_is_not(tmp_path):
    rng = np.random.default_rng(4)
    rate, rests = rng.normal(5, 3, 3000), np.concatenate([np.linspace(0, 50, 2000), np.full(500, 50.0)])
    degc = np.append(rests, np.linspace(50, 30, 500))
    assert doubts(tmp_path, rate, degc) == ()
    assert doubts(tmp_path, rate, np.round(degc, 1)) == ()
    degc[700:1000] = degc[700]
    (said,) = doubts(tmp_path, rate, degc)
    assert said.startswith("temperature is 17.5088 degC in 300 rows, one after the other, the first 701, and 25.0125")


def test_a_thermometer_that_failed_for_some_rows_is_no_other_unit(tmp_path):
    rate, degc = np.random.default_rng(3).normal(5, 3, 500), np.linspace(0, 50, 500)
    degc[100:120] = -273.0
    (said,) = doubts(tmp_path, rate, degc)
    assert said == (
        "temperature is -273 degC in 20 rows, the first 101: a sensor that failed? leave these fields empty"
    )


def test_gaps_in_time_are_counted_and_stay_gaps(tmp_path):
    body = "".join(f"{t},{t % 3},{20 + t / 10}\n" for t in [*range(50), *range(500, 550)])
    plan = imported(write(tmp_path, "time,rate,temperature\n" + body))
    assert plan.warnings[0].startswith("gaps in time: 1, together 451 s, the first before line 52")
    assert plan.time.size == 100


def ramps(step_s=1.0, first=0.0, rows=4000, low=-40.0, high=85.0, rate=None):
    """Rows of a ramp up and down, a row every so many seconds as the file says."""
    rng = np.random.default_rng(3)
    degc = low + (high - low) * (1 - np.abs(np.linspace(-1, 1, rows)))
    rates = rng.normal(5, 1, rows) if rate is None else np.full(rows, rate)
    lines = (f"{first + i * step_s!r},{rates[i]:.4f},{degc[i]:.4f}" for i in range(rows))
    return "time,rate,temperature\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (ramps(1e-12), "one row every 1e-12 s"),
        (ramps(1e7), "years"),
        (ramps(1e7, rows=5), "one row every 1e+07 s"),
        ("time,rate,temperature\n0,1,20\n1,2,21\n1e300,1,22\n", "years"),
        ("time,rate,temperature\n-1e308,1,20\n1,2,21\n1e308,1,22\n", "time"),
        ("time,rate,temperature\n0,1,20\n1,2,-400\n2,1,22\n", "FILE:3: 'temperature' (temperature) is -400 degC"),
        ("time,rate,temperature\n0,1,20\n1,2,1e5\n2,1,22\n", "FILE:3: 'temperature' (temperature) is 100000 degC"),
        ("time,rate,temperature\n0,1,20\n1,1e200,20\n2,1,22\n", "FILE:3: 'rate' (rate) is 1e+200 deg/h"),
        ("time,rate,temperature,frequency\n0,1,20,-5\n1,2,20,8000\n", "FILE:2: 'frequency' (frequency) is -5 Hz"),
        ("time,rate,temperature\n0,1,20\n1,2,1e-400\n2,1,-1e308\n", "temperature"),
    ],
)
def test_what_nothing_can_have_measured_is_refused(tmp_path, body, words):
    path = write(tmp_path, body)
    with pytest.raises(InputError) as error:
        imported(path)
    assert words.replace("FILE", str(path)) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (ramps(10.0, rows=200_000, low=20, high=40), "is the time in ms?"),
        (ramps(1000.0, rows=4000), "is the time in ms?"),
        (ramps(2.0, rows=300_000), "is the time in ms?"),
        (ramps(7200.0, rows=30), "one row every 7.2e+03 s"),
        (ramps(2e-6), "one row every 2e-06 s"),
        (ramps(0.001), "no chamber does"),
        (ramps(rate=5.25), "rate is 5.25 deg/h in every row"),
    ],
)
def test_what_is_unlikely_is_warned_of(tmp_path, body, words):
    (found,) = [warning for warning in imported(write(tmp_path, body)).warnings if words in warning]
    assert "\n" not in found


def test_an_ordinary_record_is_not_doubted(tmp_path):
    for step_s, rows in ((1.0, 8000), (0.5, 15_000), (10.0, 1500), (30.0, 800)):
        assert imported(write(tmp_path, ramps(step_s, rows=rows))).warnings == ()


def test_a_rate_and_a_temperature_that_changed_places_are_asked_about(tmp_path):
    rng, air = np.random.default_rng(7), 25.0 + 40.0 * np.sin(np.arange(800) / 127.0)
    noise, unit = rng.normal(0.0, 3.0, 800), air - 0.5 + rng.normal(0.0, 0.1, 800)
    columns = ColumnMap(
        time=TimeSource(interval_s=1),
        rate=ChannelSource(column="rate", unit="deg/h"),
        temperature=ChannelSource(column="temperature", unit="degC"),
        chamber_temperature=ChannelSource(column="air", unit="degC"),
    )

    def plan(rate, temperature):
        rows = (f"{r!r},{t!r},{a!r}" for r, t, a in zip(rate.tolist(), temperature.tolist(), air.tolist(), strict=True))
        return imported(write(tmp_path, "\n".join(["rate,temperature,air", *rows, ""])), columns)

    assert not any("swapped" in text for text in plan(noise, unit).warnings)
    swapped = plan(unit, noise)
    asked = "rate follows the temperature of the chamber and temperature does not: are the two columns swapped?"
    assert asked in swapped.warnings
    assert swapped.preview().count("  branch ") <= 24 < len(swapped.branches)
    assert f"… and {len(swapped.branches) - 24} further branches" in swapped.preview()
