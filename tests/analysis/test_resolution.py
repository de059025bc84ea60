"""Steps of thermometer and output are found before anything is named."""

from dataclasses import replace

import numpy as np
import pytest

from bench.analysis.diagnosis.resolution import Resolution, resolution
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


def test_the_error_is_that_of_rounding_and_dither_takes_it_away():
    coarse = record(np.round(RATE / 0.5) * 0.5, TEMPERATURE)
    quiet = resolution([coarse], np.zeros(1), 0.01)
    assert quiet.rate_error_dph == pytest.approx(0.5 / np.sqrt(12.0), rel=0.02)
    assert quiet.rate_error_dph == pytest.approx(np.std(coarse.bias - RATE), rel=0.06)
    assert resolution([coarse], np.zeros(1), 0.5).rate_error_dph < 1e-6
    assert quiet.matters(0.1)
    assert quiet.hides(np.full(10, 0.1))
    assert not quiet.hides(np.full(10, 0.5))
    assert not replace(quiet, rate_error_dph=0.001).matters(0.1)
    assert not Resolution().matters(np.nan)


def test_noise_of_the_rows_dithers_an_output_although_their_means_are_quiet():
    """Means over 30 rows have a fifth of their noise; their error of rounding is what is measured here."""
    temperature = 22.5 + 40.0 * np.sin(TIME / 4000.0)
    exact = 0.05 * temperature + np.random.default_rng(1).normal(0.0, 0.6, TIME.size)
    means = record(np.round(exact / 2.0) * 2.0, temperature).average(30.0)
    true = record(exact, temperature).average(30.0)
    found = resolved(Layout(fit_rows(Model("m", (effects.make("polynomial"),)), (means,)), np.zeros(0)), 0.1).resolution
    assert found.rate_error_dph == pytest.approx(np.std(means.bias - true.bias), rel=0.6)


def test_columns_of_rounding_take_most_of_its_error():
    columns = Resolution(rate_step_dph=0.5).rounding(RATE)
    error = np.round(RATE / 0.5) * 0.5 - RATE
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    assert np.std(left) < 0.5 * np.std(error)


@pytest.mark.slow
@pytest.mark.parametrize("trap", ["output step 0.5 deg/h, quiet", "thermometer step 1 degC"])
def test_steps_do_not_become_an_effect(trap):
    found = run_case(Case(trap, 1))
    assert judged(trap, found) in {"nothing", "undecided"}, found
    assert "steps of" in found["noise"]
