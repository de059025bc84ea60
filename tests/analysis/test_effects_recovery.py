"""Base curve and effect fitted together to a noisy run of known truth: every parameter within its stated uncertainty.

The truth of the terms with memory comes from integrators of this file's own at 1 s, not from the library's operators.
"""

import numpy as np
import pytest

from bench.analysis.diagnosis.evidence import weigh
from bench.analysis.diagnosis.offer import offer
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.example import example
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.fitting import fit_model
from bench.base.errors import InputError
from bench.record.dataset import Dataset
from tests.support.analysis_data import white

SIGMA_DPH = 0.05
RUN = example()
FINE_S = np.arange(RUN.time[0], RUN.time[-1] + 0.5, 1.0)
FINE = {name: np.interp(FINE_S, RUN.time, RUN.channel(name)) for name in ("temperature", "frequency", "drive")}
T, W = RUN.channel("temperature"), RUN.channel("applied_rate")
WARMER = T - 25.0


def smooth_curve(temperature):
    return 2.0 + 0.05 * temperature + 4e-4 * (temperature - 20.0) ** 2 - 2e-6 * (temperature - 20.0) ** 3


def lagged(tau_s, value=FINE["temperature"]):
    """Crank-Nicolson at 1 s, read at the rows."""
    state, out = value[0], np.empty(value.size)
    out[0] = state
    for i in range(1, value.size):
        state += ((value[i] + value[i - 1]) / 2 - state) / (tau_s + 0.5)
        out[i] = state
    return np.interp(RUN.time, FINE_S, out)


def follower(half_width, value=FINE["temperature"]):
    """A block dragged by a slot: pushed from either side."""
    block, out = value[0], []
    for slot in value:
        block = np.clip(block, slot - half_width, slot + half_width)
        out.append(block)
    return np.interp(RUN.time, FINE_S, out)


HOURS = RUN.time / 3600.0
PERCENT = 100.0 * (RUN.channel("drive") / (0.5 * np.ptp(RUN.channel("drive")) + RUN.channel("drive").min()) - 1.0)
Q, V = RUN.channel("quadrature"), RUN.channel("supply")
SLOPE = np.gradient(T, RUN.time / 60.0)

CASES = {
    "thermal_lag": (smooth_curve(lagged(150.0)) - smooth_curve(T), {"tau_s": 150.0}, {}),
    "temperature_rate": (0.3 * SLOPE, {}, {"k1": 0.3}),
    "hysteresis": (0.4 * (T - follower(9.0)) / 9.0, {"width_degc": 9.0}, {"a": 0.4}),
    "creep": (0.02 * (lagged(3.0 * 3600.0) - T), {"tau_h": 3.0}, {"k": 0.02}),
    "warm_up": (1.5 * np.exp(-RUN.time / 800.0), {"tau_s": 800.0}, {"a": 1.5}),
    "aging": (0.05 * HOURS, {}, {"line": 0.05}),
    "quadrature_leakage": (0.8 * Q + 0.02 * Q * WARMER, {}, {"b": 0.02}),
    "drive_amplitude": (0.9 * PERCENT, {}, {"k1": 0.9}),
    "resonance_frequency": (4.0 * (RUN.channel("frequency") - 14000.0), {}, {"c1": 4.0}),
    "supply_voltage": (10.0 * (V - 5.0), {}, {"k": 10.0}),
    "compressor": (0.4 * RUN.channel("compressor"), {}, {"a": 0.4}),
    "bias_jump": (0.3 * (HOURS > 4.001), {"at_h": 4.001}, {"a": 0.3}),
    "bias_kink": (0.05 * np.maximum(T - 38.0, 0.0), {"at_degc": 38.0}, {"k": 0.05}),
    "scale_factor": (3600e-6 * W * 20.0, {}, {"s0": 20.0}),
    "scale_factor_temperature": (3600e-6 * W * (20.0 + 2.0 * WARMER), {}, {"s0": 20.0, "s1": 2.0, "s2": 0.0}),
    "scale_factor_nonlinearity": (3600e-6 * (10 * W + 0.2 * W**2 + 0.003 * W**3), {}, {"c2": 0.2, "c3": 0.003}),
}  # fmt: skip


def recorded(bias, seed):
    rate = RUN.channel("rate") + bias + white(RUN, SIGMA_DPH, seed)
    return Dataset("made", RUN.time, {**RUN.channels, "rate": rate}, RUN.segment, RUN.segments, RUN.interval_s)


@pytest.mark.parametrize("name", CASES)
def test_an_effect_beside_a_spline_is_found_within_its_uncertainty(name):
    bias, theta, amplitudes = CASES[name]
    run = recorded(smooth_curve(T) + bias, seed=len(name))
    effect = effects.make(name).suited([run])
    model = Model("base and effect", (effects.make("spline", {"intervals": 6}), effect))
    found = fit_model(model, run)
    assert found.rms_dph == pytest.approx(SIGMA_DPH, rel=0.08)
    coefficients = {c.key: c for c in found.coefficients}
    for label, true in amplitudes.items():
        got = coefficients[f"{name}.{label}"]
        assert abs(got.value - true) < 4.0 * got.std + 0.01 * abs(true)
        assert got.std < 0.25 * abs(true) or true == 0.0
    for label, true in theta.items():
        got, std = found.theta[f"{name}.{label}"], found.theta_std[f"{name}.{label}"]
        assert abs(got - true) < 4.0 * std + 0.01 * abs(true)
        assert std < 0.3 * abs(true)


def test_frost_beside_a_spline_is_found():
    effect = effects.make("frost")
    truth = effect.columns(RUN, {"at_degc": 2.0, "width_degc": 4.0})[:, 0]
    run = recorded(smooth_curve(T) + 0.5 * truth, seed=3)
    found = fit_model(Model("m", (effects.make("spline", {"intervals": 6}), effect)), run)
    assert found.theta["frost.at_degc"] == pytest.approx(2.0, abs=0.5)
    assert found.coefficients[-1].value == pytest.approx(0.5, abs=0.06)


def test_a_surface_finds_scale_factor_and_bias_at_once():
    turned = 25.0 * (RUN.time // 420.0 * 5 % 7 - 3)
    true = smooth_curve(T) + 3600e-6 * turned * (5.0 + 1.0 * WARMER) + 1e-5 * turned**2
    run = recorded(true - RUN.channel("rate") + 3600.0 * turned, seed=4).with_channel("applied_rate", turned)
    found = fit_model(Model("m", (effects.make("surface"),)), run)
    assert len(found.coefficients) == 21
    assert found.rms_dph == pytest.approx(SIGMA_DPH, rel=0.08)
    modelled = found.predict(run).bias
    assert np.sqrt(np.mean((modelled - true) ** 2)) < 0.3 * SIGMA_DPH


def test_a_surface_needs_more_rates_than_its_order():
    with pytest.raises(InputError, match="the run has 5 rates, order 5 needs 6"):
        fit_model(Model("m", (effects.make("surface"),)), recorded(smooth_curve(T), seed=4))


def test_a_lag_and_a_hysteresis_are_told_apart_in_one_fit():
    """Behind a lag all terms see the resonator's temperature, the loop as well."""
    hidden = lagged(150.0)
    loop = (hidden - follower(9.0, np.interp(FINE_S, RUN.time, hidden))) / 9.0
    run = recorded(smooth_curve(hidden) + 0.4 * loop, seed=5)
    base = effects.make("spline", {"intervals": 6})
    found = fit_model(Model("m", (base, effects.make("thermal_lag"), effects.make("hysteresis"))), run)
    for key, true in {"thermal_lag.tau_s": 150.0, "hysteresis.width_degc": 9.0}.items():
        assert abs(found.theta[key] - true) < 4.0 * found.theta_std[key]
        assert found.theta_std[key] < 0.2 * true
    assert found.rms_dph == pytest.approx(SIGMA_DPH, rel=0.08)


def with_corner(temperature, at_degc):
    return smooth_curve(temperature) + 0.4 * np.logaddexp(0.0, temperature - at_degc)


@pytest.mark.parametrize("at_degc", [-25.0, -8.0, 20.0, 55.0])
def test_a_corner_behind_a_lag_is_found_wherever_it_is(at_degc):
    """Beside a spline its place has a minimum in every interval."""
    run = recorded(with_corner(lagged(150.0), at_degc), seed=7)
    parts = (effects.make("spline", {"intervals": 8}), effects.make("thermal_lag"), effects.make("bias_kink"))
    found = fit_model(Model("m", parts), run)
    assert found.theta["bias_kink.at_degc"] == pytest.approx(at_degc, abs=0.5)
    assert found.theta["thermal_lag.tau_s"] == pytest.approx(150.0, abs=2.0)
    assert found.rms_dph == pytest.approx(SIGMA_DPH, rel=0.08)


def test_a_lag_of_one_pole_is_not_taken_for_two_between_the_points_of_the_grid():
    run = recorded(with_corner(lagged(60.0), 33.0), seed=7)
    model = Model("m", (effects.make("spline", {"intervals": 8}), effects.make("bias_kink")))
    theta = np.array(list(fit_model(model, run).theta.values()))
    layout, offered = offer(Layout(fit_rows(model, (run,), None), theta), [effects.make("thermal_lag")])
    best = weigh(layout.problem, offered.candidates(layout), 0).suspects[0]
    assert offered.effects[best.name].second == 0.0
    assert best.theta[0] == pytest.approx(60.0, abs=1.0)


def test_frequency_as_the_abscissa_removes_a_lag_that_frequency_follows():
    hidden = lagged(200.0)
    truth = smooth_curve(hidden)
    run = recorded(truth, seed=6).with_channel("frequency", 14000.0 * (1.0 - 8e-6 * (hidden - 25.0)))
    base = effects.make("spline", {"intervals": 6})
    sensor = fit_model(Model("sensor", (base,)), run)
    frequency = fit_model(Model("f", (base, effects.make("resonance_frequency", {"use": "thermometer"}))), run)
    assert sensor.rms_dph > 2.0 * frequency.rms_dph
    assert frequency.rms_dph == pytest.approx(SIGMA_DPH, rel=0.08)
