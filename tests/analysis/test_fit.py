import json
from dataclasses import dataclass
from pathlib import Path

import mpmath
import numpy as np
import pytest
import statsmodels.api as sm
from scipy.interpolate import BSpline, CubicSpline, make_lsq_spline
from scipy.optimize import curve_fit
from scipy.stats import binned_statistic

from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect, Parameter
from bench.analysis.effects.model import Model, load_model
from bench.analysis.fit.fitting import fit_model
from bench.base.errors import InputError
from bench.record.dataset import Dataset
from tests.support.analysis_data import curve, thermal_cycle, white, with_bias

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "nist_strd.json").read_text())


def model(name, **options):
    return Model(name, (effects.make(name, options),))


def noisy(seed=0, sigma=0.2):
    record = thermal_cycle()
    return with_bias(record, curve(record.channels["temperature"]) + white(record, sigma, seed))


def by_key(found):
    return {coefficient.key: coefficient for coefficient in found.coefficients}


# --- agreement with independent implementations ---------------------------------------------------


@pytest.mark.parametrize("name", ["filip", "wampler5"])
def test_nist_certified_coefficients(name):
    data = GOLDEN[name]
    x, y = np.array(data["x"]), np.array(data["y"])
    time = np.arange(x.size, dtype=float)
    record = Dataset(name, time, {"rate": y, "temperature": x}, np.zeros(x.size, dtype=np.int64))
    found = fit_model(model("polynomial", order=data["order"]), record, covariance="none", weights="count")
    values = [coefficient.value for coefficient in found.coefficients]
    np.testing.assert_allclose(values, data["coefficients"], rtol=1e-8)
    left = x.size - data["order"] - 1
    np.testing.assert_allclose(found.rms_dph * np.sqrt(x.size / left), data["residual_std"], rtol=1e-11)
    assert found.condition < 1e4


def high_precision(columns, y):
    """Least squares of raw powers with 80 digits: fitted values and coefficients."""
    with mpmath.workdps(80):
        matrix = mpmath.matrix(len(y), 1 + sum(order for _, order in columns))
        for i in range(len(y)):
            row = [mpmath.mpf(1)] + [mpmath.mpf(float(c[i])) ** p for c, order in columns for p in range(1, order + 1)]
            for j, value in enumerate(row):
                matrix[i, j] = value
        beta = mpmath.lu_solve(matrix.T * matrix, matrix.T * mpmath.matrix([mpmath.mpf(float(v)) for v in y]))
        fitted = matrix * beta
        return np.array([float(v) for v in fitted]), np.array([float(b) for b in beta])


def test_fifth_power_of_temperature_agrees_with_80_digits():
    record = noisy().select(np.arange(720) % 9 == 0)
    fitted, beta = high_precision([(record.channels["temperature"], 5)], record.bias)
    found = fit_model(model("polynomial", order=5), record, covariance="none", weights="count")
    np.testing.assert_allclose(found.predict(record).bias, fitted, rtol=0, atol=1e-12)
    np.testing.assert_allclose([c.value for c in found.coefficients], beta, rtol=1e-9)


def test_a_14_khz_frequency_that_moves_by_a_thousandth_agrees_with_80_digits():
    record = thermal_cycle().select(np.arange(720) % 9 == 0)
    frequency = 14000.0 + 7.0 * np.sin(record.time / 3000.0)
    record = record.with_channel("frequency", frequency)
    truth = curve(record.channels["temperature"]) + 0.02 * (frequency - 14000) ** 3 + white(record, 0.2)
    record = with_bias(record, truth)
    channels = [(record.channels[name], 3) for name in ("temperature", "frequency", "drive", "quadrature")]
    fitted, beta = high_precision(channels, record.bias)
    found = fit_model(load_model("regression"), record, covariance="none", weights="count")
    np.testing.assert_allclose(found.predict(record).bias, fitted, rtol=0, atol=1e-10)
    np.testing.assert_allclose([c.value for c in found.coefficients], beta, rtol=1e-7)
    assert found.condition < 1e6


def test_the_cubic_agrees_with_statsmodels():
    record = noisy()
    scaled = record.channels["temperature"] / 85.0
    reference = sm.OLS(record.bias, np.vander(scaled, 4, increasing=True)).fit()
    found = fit_model(load_model("polynomial"), record, weights="count")
    values = np.array([c.value for c in found.coefficients]) * 85.0 ** np.arange(4)
    np.testing.assert_allclose(values, reference.params, rtol=1e-9)
    np.testing.assert_allclose(found.rms_dph, np.sqrt(reference.ssr / 720), rtol=1e-12)


def test_counts_weigh_the_rows_as_statsmodels_does():
    record = noisy()
    counts = np.where(np.arange(720) % 5 == 0, 7.0, 15.0)
    record = Dataset("d", record.time, record.channels, record.segment, (), 30.0, {"rate": counts})
    scaled = record.channels["temperature"] / 85.0
    reference = sm.WLS(record.bias, np.vander(scaled, 4, increasing=True), weights=counts).fit()
    found = fit_model(load_model("polynomial"), record, covariance="none", weights="count")
    np.testing.assert_allclose(found.predict(record).bias, reference.fittedvalues, rtol=1e-9)


def test_the_free_spline_agrees_with_scipy():
    record = noisy()
    temperature = record.channels["temperature"]
    found = fit_model(model("spline", intervals=24, ends="free"), record)
    order = np.argsort(temperature)
    knots = np.array(found.bound.effects[0].state()["knots"])
    clamped = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
    reference = make_lsq_spline(temperature[order], record.bias[order], clamped, 3, method="qr")
    np.testing.assert_allclose(found.predict(record).bias, reference(temperature), rtol=1e-9)


@pytest.mark.parametrize("ends", ["natural", "parabolic", "periodic"])
def test_constrained_splines_agree_with_the_constrained_optimum(ends):
    """Independent: all piece coefficients as unknowns, continuity and ends as constraints (KKT system)."""
    record = noisy()
    m = 6
    found = fit_model(model("spline", intervals=m, ends=ends), record, covariance="none", weights="count")
    knots = np.array(found.bound.effects[0].state()["knots"])
    width = knots[1] - knots[0]
    temperature = record.channels["temperature"]
    piece = np.clip(((temperature - knots[0]) / width).astype(int), 0, m - 1)
    u = (temperature - knots[piece]) / width
    design = np.zeros((720, 4 * m))
    for j in range(4):
        design[np.arange(720), 4 * piece + j] = u**j
    at_end = np.array([[1, 1, 1, 1], [0, 1, 2, 3], [0, 0, 2, 6.0]])
    at_start = np.diag([1, 1, 2.0, 0])[:3]
    rows = []
    for i in range(m - 1):
        block = np.zeros((3, 4 * m))
        block[:, 4 * i : 4 * i + 4], block[:, 4 * i + 4 : 4 * i + 8] = at_end, -at_start
        rows.append(block)
    last = np.zeros((2, 4 * m))
    if ends == "periodic":
        last[:, -4:], last[:, :4] = at_end[1:], -at_start[1:]
    elif ends == "natural":
        last[0, 2], last[1, -4:] = 1.0, at_end[2]
    else:
        last[0, 3], last[1, -1] = 1.0, 1.0
    rows.append(last)
    constraints = np.vstack(rows)
    c = len(constraints)
    kkt = np.block([[design.T @ design, constraints.T], [constraints, np.zeros((c, c))]])
    solution = np.linalg.solve(kkt, np.concatenate([design.T @ record.bias, np.zeros(c)]))[: 4 * m]
    ours = np.array([coefficient.value for coefficient in found.coefficients]).reshape(m, 4) * width ** np.arange(4)
    np.testing.assert_allclose(ours, solution.reshape(m, 4), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("ends", ["natural", "parabolic", "periodic"])
def test_a_spline_of_bins_goes_through_their_means(ends):
    """S(x_i) = f(x_i) and two conditions at the ends; against scipy, and for the others solved by hand."""
    record, m = noisy(), 8
    found = fit_model(Model("through means", model("spline", intervals=m, ends=ends).effects, "bins"), record)
    temperature = record.channels["temperature"]
    edges = np.linspace(temperature.min(), temperature.max(), m + 2)
    knots = 0.5 * (edges[1:] + edges[:-1])
    means = binned_statistic(temperature, record.bias, "mean", edges).statistic
    at = np.linspace(knots[0], knots[-1], 301)
    if ends == "natural":
        truth = CubicSpline(knots, means, bc_type="natural")(at)
    else:
        clamped = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
        basis = BSpline(clamped, np.eye(m + 3), 3)
        inner = np.array([knots[0] + 1e-3, knots[-1] - 1e-3])
        turned = np.array([np.diff(basis.derivative(j)(knots[[0, -1]]), axis=0)[0] for j in (1, 2)])
        two = basis.derivative(3)(inner) if ends == "parabolic" else turned
        truth = basis(at) @ np.linalg.solve(np.vstack([basis(knots), two]), np.append(means, [0.0, 0.0]))
    there = Dataset("t", np.arange(301.0), {"rate": at, "temperature": at}, np.zeros(301, dtype=np.int64))
    np.testing.assert_allclose(found.predict(there).bias, truth, atol=1e-9)


def test_a_spline_of_bins_needs_a_number_of_intervals_and_its_ends():
    for options in ({"intervals": "auto"}, {"intervals": 8, "ends": "free"}):
        with pytest.raises(InputError, match="needs a number of intervals"):
            fit_model(Model("m", model("spline", **options).effects, "bins"), noisy())


# --- behaviour ------------------------------------------------------------------------------------


def test_an_effect_with_a_place_for_the_constant_gets_no_other_one():
    both = Model("both", (effects.make("spline", {"intervals": 8}), Warming()))
    assert "constant" not in by_key(fit_model(both, noisy(), covariance="none", weights="count"))


def test_an_effect_without_a_place_for_it_gets_a_constant_of_its_own():
    found = fit_model(Model("warm", (Warming(),)), noisy(), covariance="none", weights="count")
    assert list(by_key(found)) == ["constant", "warming.amplitude"]


def test_predictions_outside_the_fitted_range_are_flagged_and_tame():
    record = noisy()
    inside = fit_model(load_model("spline"), record, [record.channels["temperature"] < 60.0])
    prediction = inside.predict(record)
    hot = record.channels["temperature"] > inside.validity["temperature"][1]
    np.testing.assert_array_equal(prediction.out_of_range, hot)
    assert np.abs(prediction.bias[hot]).max() < 20.0
    assert inside.validity["temperature"][1] < 60.0


def test_gaps_are_not_fitted_and_not_filled():
    record = noisy()
    rate = record.channels["rate"].copy()
    rate[50:80] = np.nan
    temperature = record.channels["temperature"].copy()
    temperature[100] = np.nan
    found = fit_model(load_model("spline"), record.with_channel("rate", rate).with_channel("temperature", temperature))
    assert found.rows == 720 - 31
    assert np.isnan(found.residuals[0][[50, 100]]).all()
    assert np.isnan(found.predict(record.with_channel("temperature", temperature)).bias[100])


def test_two_runs_are_fitted_as_one():
    whole = noisy()
    early = np.arange(720) < 300
    parts = [whole.select(early), whole.select(~early)]
    together, apart = (fit_model(load_model("spline"), data, weights="count") for data in (whole, parts))
    np.testing.assert_allclose(apart.predict(whole).bias, together.predict(whole).bias, rtol=1e-9)


def test_an_automatic_spline_chooses_enough_intervals_but_not_the_most():
    found = fit_model(model("spline"), noisy(), covariance="none", weights="count")
    assert 8 <= found.model.effects[0].intervals <= 24
    record = thermal_cycle()
    straight = with_bias(record, 2.0 + 0.1 * record.channels["temperature"] + white(record, 0.2))
    assert fit_model(model("spline"), straight, covariance="none", weights="count").model.effects[0].intervals <= 4


def test_heating_only_fits_the_heating_branch_only():
    record = noisy()
    found = fit_model(Model("h", (effects.make("polynomial"),), "heating"), record)
    fitted = np.isfinite(found.residuals[0])
    assert set(record.segment[fitted][3:-3]) == {1}


def test_fixed_points_pass_exactly_through_the_soak_means():
    record = noisy()
    for rows, order in (("soaks_2", 1), ("soaks_3", 2)):
        found = fit_model(Model("f", (effects.make("polynomial", {"order": order}),), rows), record)
        assert found.rows == order + 1
        assert found.rms_dph < 1e-12
        last_half = record.select((record.segment == 2) & (record.time > 2.5 * 3600))
        point = np.array([last_half.channels["temperature"].mean()])
        at = record.select(np.arange(720) == 0).with_channel("temperature", point)
        np.testing.assert_allclose(found.predict(at).bias, last_half.bias.mean(), rtol=1e-12)
        assert np.isnan(found.coefficients[0].std)


def test_json_is_plain_and_complete():
    found = fit_model(load_model("regression"), noisy())
    content = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert len(content["coefficients"]) == 13
    assert content["validity"]["frequency"]["unit"] == "Hz"
    assert content["model"]["effects"][0]["state"]["temperature"][0] == found.validity["temperature"][0]
    assert {"rms_dph", "condition", "rows", "interval_s", "runs", "warnings"} <= set(content)


# --- nonlinear parameters -------------------------------------------------------------------------


@dataclass(frozen=True)
class Warming(Effect):
    """A exp(-t / tau): the smallest effect with a nonlinear parameter, for tests."""

    name = "warming"
    parameters = (Parameter("tau_s", "s", 60.0, 20000.0, 600.0, log=True),)
    amplitudes = (("amplitude", "deg/h"),)

    def columns(self, record, theta):
        return np.exp(-record.time / theta["tau_s"])[:, None]


@dataclass(frozen=True)
class Delayed(Effect):
    """The temperature of tau seconds ago: an effect that moves the abscissa, for tests."""

    name = "delayed"
    needs = ("temperature",)
    parameters = (Parameter("delay_s", "s", 0.0, 1200.0, 100.0),)

    def abscissa(self, record, theta):
        return np.interp(record.time - theta["delay_s"], record.time, record.channels["temperature"])


def test_a_time_constant_and_its_uncertainty_agree_with_scipy():
    record = thermal_cycle()
    temperature = record.channels["temperature"]
    biased = with_bias(record, 4.0 * np.exp(-record.time / 1800.0) + 0.02 * temperature + white(record, 0.2))

    def explicit(t, tau, amplitude, *powers):
        return amplitude * np.exp(-t / tau) + np.polynomial.polynomial.polyval(temperature / 85.0, powers)

    best, pcov = curve_fit(explicit, record.time, biased.bias, p0=[900.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    both = Model("m", (effects.make("polynomial"), Warming()))
    noise, sandwich = fit_model(both, biased), fit_model(both, biased, covariance="sandwich")
    np.testing.assert_allclose(noise.theta["warming.tau_s"], best[0], rtol=1e-4)
    np.testing.assert_allclose(by_key(noise)["warming.amplitude"].value, best[1], rtol=1e-4)
    assert noise.noise.walk == noise.noise.flicker == 0.0  # this noise is white, and the fit knows
    np.testing.assert_allclose(noise.theta_std["warming.tau_s"], np.sqrt(pcov[0, 0]), rtol=0.03)
    np.testing.assert_allclose(sandwich.theta_std["warming.tau_s"], np.sqrt(pcov[0, 0]), rtol=0.5)


def test_an_effect_may_move_the_abscissa_of_all_others_wherever_it_stands_in_the_list():
    record = thermal_cycle()
    late = np.interp(record.time - 500.0, record.time, record.channels["temperature"])
    biased = with_bias(record, curve(late) + white(record, 0.05))
    spline = effects.make("spline", {"intervals": 16})
    for order in ((spline, Delayed()), (Delayed(), spline)):
        result = fit_model(Model("m", order), biased)
        assert abs(result.theta["delayed.delay_s"] - 500.0) < 5.0
        assert result.rms_dph < 0.06
        assert 0.0 < result.theta_std["delayed.delay_s"] < 10.0


def test_a_start_replaces_the_grid():
    record = with_bias(thermal_cycle(), 4.0 * np.exp(-thermal_cycle().time / 1800.0))
    both = Model("m", (effects.make("polynomial"), Warming()))
    again = fit_model(both, record, start={"warming.tau_s": 1500.0}, covariance="none", weights="count")
    np.testing.assert_allclose(again.theta["warming.tau_s"], 1800.0, rtol=1e-3)


def test_a_parameter_that_ends_on_its_bound_is_said_to_be_not_determined():
    record = thermal_cycle()
    both = Model("m", (effects.make("polynomial"), Warming()))
    fast, slow = (fit_model(both, with_bias(record, 4.0 * np.exp(-record.time / tau_s))) for tau_s in (20.0, 1800.0))
    assert (fast.on_bound, slow.on_bound) == (("warming.tau_s",), ())
    assert fast.to_json()["parameters"][0]["at_bound"] is True
    assert slow.to_json()["parameters"][0]["at_bound"] is False
    assert "warming.tau_s = 60 is on its bound: not determined" in fast.warnings
    assert np.isnan(fast.theta_std["warming.tau_s"])
    assert fast.to_json()["parameters"][0]["std"] is None


def test_the_size_beside_a_parameter_on_its_bound_is_that_at_the_bound():
    class Fixed(Warming):
        parameters = ()

        def columns(self, record, theta):
            return super().columns(record, {"tau_s": 60.0})

    record, curve = thermal_cycle(), effects.make("polynomial")
    data = with_bias(record, 40.0 * np.exp(-record.time / 20.0) + white(record, 0.2, 0))
    searched, fixed = (fit_model(Model("m", (curve, effect())), data) for effect in (Warming, Fixed))
    assert searched.on_bound == ("warming.tau_s",)
    np.testing.assert_allclose(searched.predict(record).std, fixed.predict(record).std, rtol=0.01)


def test_memory_sees_the_whole_record_and_rows_are_masked_afterwards():
    """With rows dropped first, the delay would read a straight line across the corner that the hole hides."""
    record = thermal_cycle()
    late = np.interp(record.time - 500.0, record.time, record.channels["temperature"])
    biased = with_bias(record, curve(late))
    both = Model("m", (effects.make("spline", {"intervals": 16}), Delayed()))
    hole = np.abs((np.arange(720) % 120) - 60) < 40
    masked, cut = (
        fit_model(both, biased, [hole], covariance="none", weights="count"),
        fit_model(both, biased.select(hole), covariance="none", weights="count"),
    )
    assert masked.rms_dph < 0.1 * cut.rms_dph


def test_a_trial_parameter_that_empties_an_interval_is_judged_and_not_forbidden():
    """Refusing rows of trial parameters pushed a lag to where no interval happened to be empty: 900 s for 500 s."""
    record = thermal_cycle()
    late = np.interp(record.time - 500.0, record.time, record.channels["temperature"])
    biased = with_bias(record, curve(late))
    both = Model("m", (effects.make("spline", {"intervals": 24}), Delayed()))
    with pytest.raises(InputError, match="interval 19 of 24"):  # of the true delay, not of some other
        fit_model(both, biased, [(np.arange(720) % 100) > 40], covariance="none", weights="count")


# --- uncertainty ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["noise", "sandwich"])
def test_bands_cover_the_truth_under_white_noise(kind):
    record = thermal_cycle()
    truth = 3.0 + 0.05 * record.channels["temperature"]
    inside = []
    for seed in range(12):
        found = fit_model(
            load_model("polynomial"), with_bias(record, truth + white(record, 0.3, seed)), covariance=kind
        )
        prediction = found.predict(record)
        inside.append(np.mean(np.abs(prediction.bias - truth) < 1.96 * prediction.std))
    assert 0.85 < np.mean(inside) <= 1.0


def test_bands_know_that_noise_wanders():
    """Random walk: white-noise bands cover the truth's shape in a few per cent of cases (reference: 4 %)."""
    record = thermal_cycle()
    temperature = record.channels["temperature"]
    inside, naive = [], []
    for seed in range(12):
        walk = np.cumsum(np.random.default_rng(seed).normal(size=720)) * 0.05
        found = fit_model(load_model("polynomial"), with_bias(record, 0.05 * temperature + walk - walk.mean()))
        slope = by_key(found)["polynomial.a1"]
        inside.append(abs(slope.value - 0.05) < 1.96 * slope.std)
        reference = sm.OLS(walk, np.vander(temperature, 4, increasing=True)).fit()
        naive.append(abs(reference.params[1]) < 1.96 * reference.bse[1])
    assert np.mean(inside) > 0.8
    assert np.mean(naive) < 0.5


# --- refusals -------------------------------------------------------------------------------------


def test_a_constant_temperature_is_refused():
    record = noisy().with_channel("temperature", np.full(720, 25.0))
    with pytest.raises(InputError, match=r"temperature moves by 0 degC only .* cannot be determined"):
        fit_model(load_model("spline"), record)


def test_zero_rows_are_refused():
    record = noisy()
    for rows in ([np.zeros(720, dtype=bool)], None):
        empty = record if rows else record.select(np.zeros(720, dtype=bool))
        with pytest.raises(InputError, match="zero rows to fit" if rows else "or shorter than one of its means"):
            fit_model(load_model("polynomial"), empty, rows)
    with pytest.raises(InputError, match="one mask a dataset"):
        fit_model(load_model("polynomial"), record, [np.ones(3, dtype=bool)])


def test_fewer_rows_than_coefficients_are_refused():
    with pytest.raises(InputError, match="10 rows for 13 coefficients"):
        fit_model(load_model("regression"), noisy().select(np.arange(720) % 72 == 0))


def test_a_missing_channel_is_refused_by_name():
    record = noisy()
    bare = Dataset("bare", record.time, {k: record.channels[k] for k in ("rate", "temperature")}, record.segment)
    with pytest.raises(InputError, match=r"channel 'frequency' \[Hz\] is missing"):
        fit_model(load_model("regression"), bare)


def test_terms_that_repeat_each_other_are_refused_by_name():
    twice = Model("twice", (effects.make("polynomial"), effects.make("regression")))
    with pytest.raises(InputError, match=r"'(polynomial|regression)' repeats what the other terms contain"):
        fit_model(twice, noisy())
    record = noisy()
    copied = record.with_channel("drive", record.channels["temperature"] * 1e-3)
    with pytest.raises(InputError, match="is not determined by these rows"):
        fit_model(load_model("regression"), copied)


def test_the_fixed_temperature_method_needs_its_soaks():
    record = noisy().select(thermal_cycle().segment == 1)
    with pytest.raises(InputError, match="needs 2 soaks; cycle has none"):
        fit_model(Model("f", (effects.make("polynomial", {"order": 1}),), "soaks_2"), record)


@pytest.mark.parametrize("from_raw", [True, False])
def test_one_degree_steps_of_the_sensor_are_found_and_sized(from_raw):
    record = thermal_cycle(1.0, 1200.0) if from_raw else thermal_cycle(30.0)
    truth = record.channels["temperature"]
    coarse = with_bias(record.with_channel("temperature", np.round(truth)), 0.5 * truth + white(record, 0.01))
    coarse = coarse.average(10.0) if from_raw else coarse
    found = fit_model(load_model("polynomial"), coarse)
    assert "steps of 1 degC; they cause 0.144 deg/h RMS" in found.warnings[0]


def test_a_fine_sensor_is_not_called_coarse():
    record = thermal_cycle(1.0, 1200.0)
    fine = record.with_channel("temperature", np.round(record.channels["temperature"] / 0.005) * 0.005)
    for sensor in (record, fine, fine.average(30.0)):
        assert (
            fit_model(
                load_model("polynomial"), with_bias(sensor, curve(sensor.channels["temperature"])), covariance="none"
            ).warnings
            == ()
        )


@pytest.mark.parametrize(("ends", "zero"), [("natural", "piece1.a2"), ("parabolic", "piece1.a3")])
def test_what_an_end_condition_makes_zero_is_exactly_zero(ends, zero):
    found = by_key(fit_model(model("spline", intervals=6, ends=ends), noisy()))
    assert (found[f"spline.{zero}"].value, found[f"spline.{zero}"].std) == (0.0, 0.0)
    assert found["spline.piece2.a2"].std > 0.0
