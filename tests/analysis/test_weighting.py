"""Coefficients by the noise that the fit itself shows: generalised least squares."""

import numpy as np
import pytest
import statsmodels.api as sm

from bench.analysis.diagnosis.compare import compare
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model, load_model
from bench.analysis.fit.fitting import fit_model
from bench.analysis.noise.whitening import covariance
from bench.record.dataset import Dataset
from tests.support.analysis_data import thermal_cycle, white, with_bias

ORDER = 3
RATE = Model("rate", (effects.make("polynomial", {"order": ORDER}), effects.make("temperature_rate")))


def curve(temperature):
    return 2.0 + 0.03 * temperature - 2e-4 * temperature**2 + 2e-6 * temperature**3


def wandering(seed, record=None, step=0.03, sigma=0.1):
    """A cubic with white noise and a random walk."""
    record = thermal_cycle() if record is None else record
    walk = np.cumsum(np.random.default_rng(seed).normal(size=len(record))) * step
    return with_bias(record, curve(record.channels["temperature"]) + white(record, sigma, seed) + walk)


def powers(record):
    return np.vander(record.channels["temperature"] / 85.0, ORDER + 1, increasing=True)


def dense(found, record):
    """The covariance that the fit found, as a matrix [(deg/h)^2]."""
    noise = found.weights.found
    counts = record.count("rate")
    return noise.sigma2 * covariance(record.time, record.interval_s, noise.ratios, np.median(counts) / counts)


def test_coefficients_and_their_deviations_agree_with_statsmodels_gls():
    record = wandering(1)
    found = fit_model(load_model("polynomial"), record)
    assert found.noise.walk > 0.0
    sigma, columns = dense(found, record), powers(record)
    reference = sm.GLS(record.bias, columns, sigma=sigma).fit(cov_type="nonrobust")
    scale = 85.0 ** np.arange(ORDER + 1)
    values = np.array([c.value for c in found.coefficients]) * scale
    np.testing.assert_allclose(values[1:], reference.params[1:], rtol=1e-9)
    shape = columns[:, 1:] @ reference.params[1:]
    np.testing.assert_allclose(values[0], np.mean(record.bias - shape), rtol=1e-9)
    expected = np.sqrt(np.diag(reference.normalized_cov_params))
    np.testing.assert_allclose([c.std for c in found.coefficients][1:] * scale[1:], expected[1:], rtol=1e-6)


def test_the_deviation_of_the_level_is_that_of_the_mean_of_the_run():
    """Independent: the whole estimate as one matrix, and the noise's covariance through it."""
    record = wandering(2)
    found = fit_model(load_model("polynomial"), record)
    sigma, columns = dense(found, record), powers(record)
    inverse = np.linalg.inv(sigma)
    matrix = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse)
    matrix[0] = 1.0 / len(record) - columns[:, 1:].mean(axis=0) @ matrix[1:]
    np.testing.assert_allclose(matrix[0] @ record.bias, found.coefficients[0].value, rtol=1e-9)
    np.testing.assert_allclose(found.coefficients[0].std, np.sqrt(matrix[0] @ sigma @ matrix[0]), rtol=1e-6)


def test_rows_left_out_are_left_out_of_the_noise_too():
    """The fit to a part of the rows is statsmodels' with the part of the covariance that belongs to them."""
    record = wandering(3)
    whole = fit_model(load_model("polynomial"), record)
    kept = (np.arange(len(record)) < 200) | (np.arange(len(record)) > 300)
    part = fit_model(load_model("polynomial"), record, [kept], covariance="none", weights=whole.weights)
    sigma = dense(whole, record)[np.ix_(kept, kept)]
    reference = sm.GLS(record.bias[kept], powers(record)[kept], sigma=sigma).fit()
    values = np.array([c.value for c in part.coefficients]) * 85.0 ** np.arange(ORDER + 1)
    np.testing.assert_allclose(values[1:], reference.params[1:], rtol=1e-8)


def test_under_white_noise_rows_count_by_their_samples():
    record = wandering(0, step=0.0)
    by_noise = fit_model(load_model("polynomial"), record)
    assert by_noise.noise.walk == by_noise.noise.flicker == 0.0
    np.testing.assert_allclose(by_noise.beta, by_noise.counted.beta, rtol=1e-9)


def test_the_error_on_unseen_runs_falls_where_noise_wanders():
    """Of 8 runs with a random walk, the error of the curve's shape on another profile, noise left out."""
    squares = {"noise": 0.0, "count": 0.0}
    other = thermal_cycle().select(np.arange(720) > 360)
    truth = curve(other.channels["temperature"]) + 0.2 * np.nan_to_num(other.dT_dt)
    for seed in range(8):
        record = thermal_cycle()
        record = with_bias(record, wandering(seed, record).bias + 0.2 * np.nan_to_num(record.dT_dt))
        found = fit_model(RATE, record, covariance="none")
        for name, fit in (("noise", found), ("count", found.counted)):
            error = fit.predict(other).bias - truth
            squares[name] += float(np.nanvar(error))
    assert squares["noise"] < 0.7 * squares["count"]


def test_nonlinear_parameters_are_searched_under_the_same_noise():
    errors = {"noise": [], "count": []}
    model = Model("warm", (effects.make("polynomial"), effects.make("warm_up")))
    for seed in range(4):
        record = thermal_cycle()
        record = with_bias(record, wandering(seed, record).bias + 4.0 * np.exp(-record.time / 1800.0))
        found = fit_model(model, record)
        for name, fit in (("noise", found), ("count", found.counted)):
            errors[name].append(np.log(fit.theta["warm_up.tau_s"] / 1800.0))
        assert abs(errors["noise"][-1]) < 4.0 * found.theta_std["warm_up.tau_s"] / found.theta["warm_up.tau_s"]
    assert np.std(errors["noise"]) < np.std(errors["count"])


def test_a_comparison_states_both():
    record = wandering(4)
    (score,) = compare(record, [load_model("polynomial")], 0.1, wandering(5)).scores
    plain = fit_model(load_model("polynomial"), record, weights="count")
    assert score.counted.rms_dph == pytest.approx(plain.rms_dph, rel=1e-12)
    assert score.rms_dph > score.counted.rms_dph  # least squares cannot be beaten in-sample
    (written,) = compare(record, [load_model("polynomial")], 0.1).to_json()["models"]
    assert written["weights"] == {"by": "noise", "reason": ""}
    assert set(written["counted"]) == {"rms_dph", "held_out_rms_dph"}


def test_where_the_noise_cannot_be_estimated_the_reason_is_said():
    record = wandering(6)
    few = fit_model(load_model("polynomial"), record.select(np.arange(720) % 150 == 0))
    assert few.weights is None
    assert few.counted is None
    assert few.weights_reason == "5 rows for 4 coefficients leave none to estimate the noise from"
    binned = fit_model(Model("m", (effects.make("spline", {"intervals": 6}),), "bins"), record)
    assert "no order in time" in binned.weights_reason
    time = np.arange(4001.0) * 30.0
    temperature = 20.0 + 30.0 * np.sin(time / 5000.0)
    rate = curve(temperature) + 0.1 * np.random.default_rng(0).normal(size=time.size)
    long = Dataset("d", time, {"rate": rate, "temperature": temperature}, np.zeros(4001, np.int64), (), 30.0)
    assert "at most 4000 rows, there are 4001" in fit_model(load_model("polynomial"), long).weights_reason


def test_a_model_that_leaves_much_more_than_the_stand_stills_show_is_weighted_by_counts():
    """What it lacks would pass for slow noise."""
    record = wandering(7, step=0.0)
    lacking = with_bias(record, record.bias + 3.0 * np.nan_to_num(record.dT_dt))
    found = fit_model(load_model("polynomial"), lacking)
    assert "would pass for slow noise" in found.weights_reason
    assert found.weights is None
    assert np.all(np.isfinite(np.diag(found.covariance)))
    np.testing.assert_array_equal(found.beta, fit_model(load_model("polynomial"), lacking, weights="count").beta)
    assert fit_model(RATE, lacking).weights is not None
