"""Steps of thermometer and output are found before anything is named."""

from dataclasses import replace

import numpy as np
import pytest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.diagnosis.resolution import Resolution
from bench.analysis.diagnosis.suspects import Layout, resolved
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.record.dataset import Dataset
from benchmarks.traps import Case, judged, run_case


def record(rate, temperature):
    time = np.arange(len(rate), dtype=float)
    return Dataset("made", time, {"rate": rate, "temperature": temperature}, np.zeros(len(rate), np.int64), (), 1.0)


TIME = np.arange(20_000.0)
RATE, TEMPERATURE = 3.0 * np.sin(TIME / 3000.0), 20.0 + 40.0 * np.sin(TIME / 4000.0)


def test_steps_are_found_in_rows_and_remembered_by_their_means():
    fine = record(np.round(RATE / 0.5) * 0.5, np.round(TEMPERATURE / 0.25) * 0.25)
    for data in (fine, fine.average(30.0)):
        assert (data.rate_step, data.temperature_step) == pytest.approx((0.5, 0.25))
    smooth = record(RATE, TEMPERATURE).average(30.0)
    assert (smooth.rate_step, smooth.temperature_step) == (0.0, 0.0)


def found(data):
    return resolved(Layout(fit_rows(Model("m", (effects.make("polynomial"),)), (data,)), np.zeros(0)), 0.0).resolution


def staircase(rng):
    """A temperature that rests at places of its own between ramps [degC], a value a second."""
    rests = np.repeat(np.cumsum(rng.uniform(2.0, 8.0, 40)), 900)
    return np.interp(np.arange(rests.size), np.arange(rests.size)[::450], rests[::450])


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.35, 0.6])
@pytest.mark.parametrize("step", [0.2, 2.0])
def test_what_the_output_s_steps_cause_in_the_means_is_that_of_simulated_rounding(step, noise):
    rng = np.random.default_rng(1)
    temperature = staircase(rng)
    exact = 0.3 * step * temperature + rng.normal(0.0, 1.0, temperature.size) * noise * step
    coarse, fine = (record(r, temperature).average(30.0) for r in (np.round(exact / step) * step, exact))
    assert found(coarse).rate_error_dph == pytest.approx(np.std(coarse.bias - fine.bias), rel=0.2)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.25])
def test_what_the_thermometer_s_steps_cause_in_the_means_is_that_of_simulated_rounding(noise):
    rng = np.random.default_rng(2)
    exact = staircase(rng)
    shown = np.round((exact + rng.normal(0.0, 0.5 * noise, exact.size)) / 0.5) * 0.5
    steps, true = (record(rate, shown).average(30.0) for rate in (0.3 * exact, 0.3 * (shown - exact)))
    assert found(steps).temperature_error_dph == pytest.approx(np.std(true.bias), rel=0.2)


def test_noise_takes_away_what_comes_back_with_the_value_and_a_moving_value_most_of_it():
    def repeats(noise, pace):
        exact = pace * TIME + np.random.default_rng(1).normal(0.0, 1.0, TIME.size) * noise
        return found(record(np.round(exact / 0.5) * 0.5, pace * TIME).average(30.0)).repeats_dph

    assert repeats(0.005, 0.001) == pytest.approx(0.5 / np.sqrt(12.0), rel=0.1)
    assert repeats(0.5, 0.001) < 1e-6
    assert repeats(0.02, 0.5 / 30.0) < 0.3 * repeats(0.02, 0.001)


def test_a_log_of_single_values_a_row_has_the_whole_error_of_rounding():
    temperature = 20.0 + 40.0 * np.sin(TIME / 4000.0)
    time = 30.0 * np.arange(len(TIME))
    rows = replace(record(np.round(0.1 * temperature / 0.5) * 0.5, temperature), time=time, interval_s=30.0)
    assert found(rows).rate_error_dph == pytest.approx(np.std(rows.bias - 0.1 * temperature), rel=0.2)


def test_an_effect_is_hidden_where_the_steps_may_cause_it():
    quiet = Resolution(rate_step_dph=0.5, rate_error_dph=0.145, repeats_dph=0.144)
    assert quiet.matters(0.1)
    assert quiet.hides(np.full(10, 0.1))
    assert not quiet.hides(np.full(10, 0.5))
    assert quiet.explains(0.15, 0.05)
    assert not quiet.explains(0.3, 0.05)
    assert not replace(quiet, repeats_dph=0.001).matters(0.1)
    assert not Resolution().matters(np.nan)


def test_columns_of_rounding_take_most_of_its_error():
    columns = Resolution(rate_step_dph=0.5).rounding(RATE)
    error = np.round(RATE / 0.5) * 0.5 - RATE
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    assert np.std(left) < 0.5 * np.std(error)


@pytest.mark.slow
@pytest.mark.parametrize(
    "trap", ["output step 0.5 deg/h, quiet", "thermometer step 1 degC", "quiet, thermometer step 0.5 degC"]
)
def test_steps_do_not_become_an_effect(trap):
    answer = run_case(Case(trap, 1))
    assert judged(trap, answer) in {"nothing", "undecided"}, answer
    assert "quiet" not in trap or any("steps of" in note for note in answer["notes"])


def test_where_steps_cause_what_is_left_the_answer_says_so_and_proposes_no_run():
    rng = np.random.default_rng(3)
    temperature = np.interp(np.arange(14_400.0), np.linspace(0.0, 14_400.0, 7), [20, 51, 50, -3, 4, 38, 20])
    exact = 3.0 * np.sin(temperature / 15.0) + rng.normal(0.0, 0.03, temperature.size)
    data = record(np.round(exact / 0.4) * 0.4, temperature).average(30.0)
    answer = diagnose([data], Model("m", (effects.make("spline", {"intervals": 8}),)), floor_dph=0.02, workers=1)
    assert (answer.verdict, answer.found, answer.formulas) == ("undecided", (), ())
    assert "as large as what steps cause: the output has steps of 0.4 deg/h" in answer.sentence
    assert "Record it with finer steps" in answer.sentence
    assert next_experiment(answer, [data]) is None
