"""The memory of what is left, and what is left over two channels, where no formula is short."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import fftconvolve
from scipy.stats import binned_statistic_2d

from bench.analysis.diagnosis.diagnose import _Case, diagnose
from bench.analysis.diagnosis.kernel import LEAST_EVIDENCE, kernel_of
from bench.analysis.diagnosis.surface import RATE_OF_TEMPERATURE, residual_surface
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.noise.estimate import Noise
from bench.analysis.noise.likelihood import NoiseLattice
from bench.analysis.noise.whitening import covariance
from bench.base.errors import InputError
from bench.deliver.report.sections_left import left
from bench.record.dataset import Dataset

SPLINE = Model("spline", (effects.make("spline", {"intervals": 8}),))
SECONDS = 6 * 3600
T = np.arange(SECONDS) + 0.5
RESPONSES = {
    "two poles": 0.03 * np.exp(-T / 120.0) + 0.02 * np.exp(-T / 1500.0),
    "one over the root": 0.05 / np.sqrt(1.0 + T / 60.0),
}
"""What is left of the bias at this time after a step of 1 degC [deg/h/degC], each second."""


def run(response, seed, noise=0.06):
    """The same in 30 s means."""
    return run_seconds(response, seed, noise).average(30.0)


def run_seconds(response=(0.0,), seed=0, noise=0.06):
    """Ramps at two rates between soaks, with a memory, white noise and a random walk."""
    corners = [0, 1800, 6000, 7200, 8700, 10500, 13200, 14400, 17100, 18900, 20400, SECONDS]
    temperature = np.interp(T, corners, [20, 20, -30, -30, 40, 40, 80, 80, 35, 35, -10, -10])
    memory = fftconvolve(np.diff(temperature, prepend=temperature[0]), response)[:SECONDS]
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(size=SECONDS)) * noise / 600.0 + rng.normal(size=SECONDS) * noise * np.sqrt(30.0)
    rate = 1.5 * (temperature / 85.0) - (temperature / 85.0) ** 2 + memory + wander
    channels = {"rate": rate, "temperature": temperature}
    return Dataset("run", T, channels, np.zeros(SECONDS, dtype=np.int64))


def layout(data):
    return Layout(fit_rows(SPLINE, (data,)), np.zeros(0))


def kernel(data):
    laid_out = layout(data)
    with one_blas_thread():
        return kernel_of(laid_out, NoiseLattice(laid_out.problem.records(), 30.0))


@pytest.mark.parametrize("name", RESPONSES)
def test_the_memory_is_recovered_within_its_band(name):
    """Up to a constant, which is a part of the curve over temperature that the model takes in."""
    found = kernel(run(RESPONSES[name], 1))
    assert found.evidence > 2 * LEAST_EVIDENCE
    truth = np.interp(found.lag_s, T, RESPONSES[name])
    level = np.average(found.value - truth, weights=found.sd**-2.0)
    apart = (found.value - truth - level) / found.sd
    assert np.mean(np.abs(apart) < 2.0) >= 0.9
    seen = found.lag_s < 1800.0
    assert np.all(found.value[seen & (found.lag_s > 60.0)] > 0.0)
    assert np.max(found.sd[seen]) < 0.6 * RESPONSES[name][0]  # a band that says something


def test_clean_runs_have_no_memory():
    assert [kernel(run(np.zeros(SECONDS), seed)) for seed in range(3)] == [None] * 3


def test_cells_agree_with_scipy():
    data = run(RESPONSES["two poles"], 2)
    fit = fit_model(SPLINE, data, covariance="none", weights="count")
    residual = fit.residuals[0]
    found = residual_surface(layout(data), residual, ("temperature", RATE_OF_TEMPERATURE), Noise(0.01, 0.0, 0.0))
    x, y = data.channel("temperature"), np.nan_to_num(data.dT_dt)
    for statistic, own in (("mean", found.mean), ("count", found.count)):
        reference = binned_statistic_2d(x, y, residual, statistic, bins=found.edges).statistic
        np.testing.assert_allclose(own, reference, rtol=1e-9, atol=1e-12)
    assert found.words.startswith("residual over temperature and rate_of_temperature: ")
    assert sum(cell["count"] for cell in found.to_json()["cells"]) == len(data)


def test_the_deviation_of_a_cell_is_what_noise_does_to_it():
    """Of 200 runs of white noise, fitted like the run: the scatter of each cell's mean."""
    data = run(np.zeros(SECONDS), 0)
    rows = fit_rows(SPLINE, (data,))
    _, columns = rows.bind(np.zeros(0))
    noise = Noise(0.01, 0.0, 0.0)
    draws = np.random.default_rng(0).normal(size=(len(data), 200)) * np.sqrt(noise.white_variance(30.0))
    beside = draws - columns @ np.linalg.lstsq(columns, draws, rcond=None)[0]
    surfaces = [
        residual_surface(layout(data), beside[:, i], ("temperature", RATE_OF_TEMPERATURE), noise) for i in (0, 1)
    ]
    x, y = data.channel("temperature"), np.nan_to_num(data.dT_dt)
    means = binned_statistic_2d(x, y, beside.T, "mean", bins=surfaces[0].edges).statistic
    visited = surfaces[0].count > 0
    ratio = means.std(axis=0)[visited] / surfaces[0].se[visited]
    assert 0.95 < np.median(ratio) < 1.05
    assert 0.8 < ratio.min() <= ratio.max() < 1.2
    assert np.mean(surfaces[1].stands_out[visited]) < 0.15


def test_the_deviation_of_a_cell_under_slow_noise_is_that_of_the_covariance_of_all_rows():
    data = run(np.zeros(SECONDS), 0)
    laid_out, noise = layout(data), Noise(0.01, 0.05, 0.1)
    found = residual_surface(laid_out, np.zeros(len(data)), ("temperature", RATE_OF_TEMPERATURE), noise)
    problem = laid_out.problem
    dense = covariance(problem.time_s, 30.0, noise.ratios(30.0)) * noise.white_variance(30.0)
    beside = np.eye(len(data)) - problem.base @ np.linalg.pinv(problem.base)
    x, y = data.channel("temperature"), np.nan_to_num(data.dT_dt)
    means = binned_statistic_2d(x, y, beside, "mean", bins=found.edges).statistic[:, found.count > 0]
    expected = np.sqrt(np.einsum("ik,ij,jk->k", means, dense, means))
    np.testing.assert_allclose(found.se[found.count > 0], expected, rtol=0.15)


def test_a_run_of_days_is_shown_in_cells_too():
    day = run(np.zeros(SECONDS), 0)
    days = replace(
        day,
        time=np.concatenate([day.time + n * SECONDS for n in range(8)]),
        channels={name: np.tile(values, 8) for name, values in day.channels.items()},
        segment=np.tile(day.segment, 8),
        counts={name: np.tile(values, 8) for name, values in day.counts.items()},
        variances={name: np.tile(values, 8) for name, values in day.variances.items()},
    )
    assert len(days) > 5000
    found = residual_surface(layout(days), np.zeros(len(days)), ("temperature", RATE_OF_TEMPERATURE), Noise(0.01, 0, 0))
    assert np.isfinite(found.se[found.count > 0]).all()


def test_a_record_with_many_short_gaps_is_diagnosed():
    """Means of what is left beside a gap lie nearer to the next mean than whole ones."""
    rng = np.random.default_rng(5)
    kept = np.ones(SECONDS, dtype=bool)
    for begin in rng.integers(0, SECONDS, 40):
        kept[begin : begin + int(rng.integers(10, 140))] = False
    loop = np.where(np.gradient(run_seconds().channel("temperature")) > 0, 0.3, -0.3)
    whole = run_seconds()
    data = replace(whole, channels={**whole.channels, "rate": whole.channels["rate"] + loop}).select(kept).average(30.0)
    assert np.diff(data.time).min() < 15.0
    answer = diagnose([data], SPLINE, candidates=[effects.make("hysteresis"), effects.make("aging")], workers=1)
    assert [suspect.effect for suspect in answer.found] == ["hysteresis"]


@pytest.mark.slow
def test_a_name_on_its_bound_gives_way_to_a_formula_that_is_as_good():
    """A memory of 20 min: the shortest creep is one of 30 min, and fits no worse."""
    answer = diagnose([run(0.008 * np.exp(-T / 1200.0), 1)], SPLINE, candidates=[effects.make("creep")], workers=1)
    (creep,) = answer.found
    assert creep.parameters["tau_h"].at_bound
    best = answer.formulas[0]
    # Of one heating and one cooling only parts can be left out, into which it is interpolated.
    assert (answer.verdict, best.proof.falls, best.proof.proved) == ("unknown_effect", True, False)
    tau_s = float(re.fullmatch(r"k \* lag\(dT_dt, ([\d.]+)\)", best.formula)[1])
    assert tau_s == pytest.approx(1200.0, rel=0.1)


def test_an_output_that_stands_still_is_not_diagnosed():
    data = run(np.zeros(SECONDS), 0)
    stuck = replace(data, channels={**data.channels, "rate": np.full(len(data), 3.25)})
    with pytest.raises(InputError, match=r"rate is 3\.25 deg/h in every row"):
        diagnose([stuck], SPLINE, workers=1)


def test_channels_that_a_run_lacks_are_named():
    data = run(np.zeros(SECONDS), 0)
    for channels, words in (
        (("temperature", "drive"), "'drive' is no channel"),
        (("temperature",), "takes two channels"),
    ):
        with pytest.raises(InputError, match=words):
            diagnose([data], SPLINE, surface=channels, candidates=[effects.make("aging")], workers=1)


def test_a_diagnosis_shows_the_memory_only_where_nothing_describes_what_is_left():
    clean = diagnose([run(np.zeros(SECONDS), 3)], SPLINE, candidates=[effects.make("aging")], workers=1)
    assert (clean.verdict, clean.kernel, clean.surface) == ("adequate", None, None)
    assert clean.to_json()["kernel"] is None
    case = _Case.of((run(RESPONSES["two poles"], 3),), SPLINE, None, [effects.make("aging")], None)
    with one_blas_thread():
        shown = case.shown(replace(clean, verdict="unknown_effect"))
    assert shown.kernel.words.startswith("memory: about ")
    assert set(shown.to_json()["kernel"]) == {"lag_s", "value", "sd", "unit", "memory_s", "evidence"}
    assert shown.surface.channels == ("temperature", RATE_OF_TEMPERATURE)
    drawn = str(left(shown))
    assert drawn.count("<figure>") == 2
    assert not left(clean)
