"""Each effect against a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects import registry as effects
from bench.analysis.effects.example import example
from bench.analysis.effects.model import Model
from bench.base.channels import CHANNELS
from bench.base.errors import InputError
from bench.record.dataset import Dataset


def record(time_s, interval_s=30.0, **channels):
    time_s = np.asarray(time_s, dtype=float)
    channels = {"rate": np.zeros(time_s.size), **{k: np.asarray(v, dtype=float) for k, v in channels.items()}}
    return Dataset("made", time_s, channels, np.zeros(time_s.size, dtype=np.int64), (), interval_s)


def ramp(rate_degc_per_min, minutes=300, start=20.0):
    time_s = np.arange(0.0, minutes * 60.0, 30.0)
    return record(time_s, temperature=start + rate_degc_per_min * time_s / 60.0)


def start_values(effect):
    return {parameter.name: parameter.start for parameter in effect.parameters}


def columns(name, data, options=None, **theta):
    effect = effects.make(name, options).prepare([data])
    return effect.columns(data, {**start_values(effect), **theta})


def test_a_lag_follows_a_ramp_at_slope_times_tau():
    data = ramp(0.2, minutes=200)
    lagged = effects.make("thermal_lag").abscissa(data, {"tau_s": 240.0})
    assert_allclose((data.channel("temperature") - lagged)[-1], 0.2 / 60.0 * 240.0, rtol=1e-9)
    assert effects.make("thermal_lag").columns(data, {"tau_s": 240.0}).shape == (len(data), 0)


@pytest.mark.parametrize(("options", "settled"), [({}, slice(0, None)), ({"filter_s": 120.0}, slice(200, None))])
def test_the_temperature_rate_of_a_ramp_is_its_slope_in_degc_per_min(options, settled):
    for rate in (0.5, -2.0):
        assert_allclose(columns("temperature_rate", ramp(rate), options)[settled, 0], rate, rtol=1e-9)


def test_the_second_rate_term_grows_with_temperature():
    data = ramp(0.1)
    both = columns("temperature_rate", data, {"temperature_slope": True})
    assert_allclose(both[:, 1], 0.1 * (data.channel("temperature") - 25.0), rtol=1e-9)


def triangle(period_min, low=-40.0, high=85.0, cycles=3):
    time_s = np.arange(0.0, cycles * period_min * 60.0, 30.0)
    phase = time_s / 60.0 / period_min % 1.0
    return record(time_s, temperature=low + (high - low) * (1.0 - np.abs(2.0 * phase - 1.0)))


@pytest.mark.parametrize("shape", ["play", "bouc_wen"])
@pytest.mark.parametrize("period_min", [250.0, 1000.0])
def test_a_hysteresis_loop_is_two_high_at_any_rate(shape, period_min):
    data = triangle(period_min)
    loop = columns("hysteresis", data, {"shape": shape}, width_degc=8.0)[:, 0]
    middle = np.abs(data.channel("temperature") - 40.0) < 3.0
    rising = np.gradient(data.channel("temperature")) > 0
    settled = data.time > data.time[-1] / 3
    assert_allclose(loop[middle & rising & settled], 1.0, atol=0.02)
    assert_allclose(loop[middle & ~rising & settled], -1.0, atol=0.02)


def test_a_play_turns_within_twice_its_half_width_of_a_reversal():
    data = triangle(250.0)
    loop = columns("hysteresis", data, width_degc=10.0)[:, 0]
    temperature = data.channel("temperature")
    falling = (np.gradient(temperature) < 0) & (data.time > 7500) & (data.time < 15000)
    assert_allclose(loop[falling], np.maximum((temperature[falling] - 75.0) / 10.0, -1.0), atol=1e-9)


def test_several_plays_have_evenly_spaced_widths():
    data = triangle(250.0)
    three = columns("hysteresis", data, {"count": 3}, width_degc=15.0)
    for i, width in enumerate((5.0, 10.0, 15.0)):
        assert_allclose(three[:, i], columns("hysteresis", data, width_degc=width)[:, 0])


def test_a_smooth_loop_obeys_its_differential_equation():
    data = triangle(250.0)
    temperature = data.channel("temperature")
    fine = np.interp(np.linspace(0, data.time[-1], 200_000), data.time, temperature)
    state, states = 0.0, []
    for step in np.diff(fine, prepend=fine[0]) / 8.0:  # Euler with steps of 0.002 degC
        state += step * (1.0 - abs(state) if state * step > 0 else 1.0)
        states.append(state)
    at_rows = np.interp(data.time, np.linspace(0, data.time[-1], 200_000), states)
    assert_allclose(columns("hysteresis", data, {"shape": "bouc_wen"}, width_degc=8.0)[:, 0], at_rows, atol=2e-3)


def test_both_loop_shapes_are_one_suspect_with_one_parameter_each():
    shapes = effects.make("hysteresis").shapes()
    assert [shape.shape for shape in shapes] == ["play", "bouc_wen"]
    assert {shape.name for shape in shapes} == {"hysteresis"}
    assert [len(shape.parameters) for shape in shapes] == [1, 1]


def test_creep_relaxes_exponentially_after_a_step():
    time_s = np.arange(0.0, 40000.0, 30.0)
    data = record(time_s, temperature=np.where(time_s < 600.0, 20.0, 70.0))
    missing = columns("creep", data, tau_h=2.0)[:, 0]
    after = time_s > 600.0
    decay = missing[after] / missing[after][0]
    assert_allclose(decay, np.exp(-(time_s[after] - time_s[after][0]) / 7200.0), rtol=1e-9)
    assert_allclose(missing[after][0], -50.0, rtol=0.01)
    free = columns("creep", data, {"initial": "free"}, tau_h=2.0)
    assert_allclose(free[:, 1], np.exp(-time_s / 7200.0))


def test_warm_up_decays_from_power_on_and_is_nothing_before():
    data = ramp(0.0)
    assert_allclose(columns("warm_up", data, tau_s=900.0)[:, 0], np.exp(-data.time / 900.0))
    late = columns("warm_up", data, {"power_on_s": 3000.0}, tau_s=900.0)[:, 0]
    assert_allclose(late[data.time < 3000.0], 0.0)
    assert_allclose(late[data.time >= 3000.0], np.exp(-(data.time[data.time >= 3000.0] - 3000.0) / 900.0))


def test_aging_is_a_line_or_a_logarithm_of_hours():
    data = ramp(0.0)
    both = columns("aging", data, {"law": "both", "settled_h": 2.0})
    assert_allclose(both[:, 0], data.time / 3600.0)
    assert_allclose(both[:, 1], np.log(1.0 + data.time / 7200.0))
    assert effects.make("aging", {"law": "logarithm"}).physical().units == ("deg/h",)


def test_a_jump_is_a_step_and_the_row_that_holds_it_takes_its_share():
    data = record(np.arange(10) * 30.0 + 15.0)
    share = columns("bias_jump", data, at_h=130.0 / 3600.0)[:, 0]
    assert_allclose(share, [0, 0, 0, 0, 20 / 30, 1, 1, 1, 1, 1], atol=1e-12)
    assert not columns("bias_jump", data, {"run": "another"}, at_h=0.03).any()


def test_what_is_left_of_a_jump_that_fades_or_returns_is_its_mean_over_each_row():
    data = record(np.arange(10) * 30.0 + 15.0)
    fine = (np.arange(300_000) + 0.5) / 1000.0
    for then, theta, value in (
        ("fades", {"tau_s": 70.0}, np.exp(-(fine - 130.0) / 70.0)),
        ("returns", {"lasts_s": 77.0}, 1.0 * (fine < 207.0)),
    ):
        found = columns("bias_jump", data, {"then": then}, at_h=130.0 / 3600.0, **theta)[:, 0]
        assert_allclose(found, np.where(fine >= 130.0, value, 0.0).reshape(10, -1).mean(axis=1), atol=1e-4)
        fitted = effects.make("bias_jump", {"then": then}).suited([data])
        assert not fitted.columns(replace(data, name="another"), {"at_h": 0.03, **theta}).any()


def test_a_jump_is_not_replayed_in_a_run_that_it_was_not_fitted_to():
    data = record(np.arange(10) * 30.0 + 15.0)
    fitted = effects.make("bias_jump").suited([data])
    assert not fitted.columns(replace(data, name="another"), {"at_h": 130.0 / 3600.0}).any()
    share = fitted.columns(data, {"at_h": 130.0 / 3600.0})[:, 0]
    assert_allclose((share.mean(), np.ptp(share)), (0.0, 1.0), atol=1e-12)  # the constant stays the level of the run


def test_several_runs_get_a_jump_of_their_own_each():
    data = record(np.arange(10) * 30.0 + 15.0)
    later = replace(data, name="later", time=data.time + 600.0)
    shapes = effects.make("bias_jump").suited([data, later]).shapes()
    assert [(shape.run, shape.then) for shape in shapes] == [
        (name, then) for then in ("stays", "fades", "returns") for name in (data.name, "later")
    ]
    assert shapes[1].parameters[0].low == later.time[2] / 3600.0
    assert not shapes[1].columns(data, {"at_h": 0.1}).any()


def test_jumps_and_kinks_are_searched_where_the_run_was():
    data = ramp(0.2)
    jump = effects.make("bias_jump").suited([data]).parameters[0]
    assert (jump.low, jump.high) == (data.time[2] / 3600.0, data.time[-3] / 3600.0)
    assert jump.change_point
    kink = effects.make("bias_kink").suited([data]).parameters[0]
    assert (kink.low, kink.high) == pytest.approx((21.8, 78.1), abs=0.1)
    assert kink.change_point
    loop = effects.make("hysteresis").suited([data]).parameters[0]
    assert loop.high == pytest.approx(0.45 * 60.0, rel=0.01)
    assert effects.make("aging").suited([data]) == effects.make("aging")
    with pytest.raises(InputError, match="no run 'elsewhere' with more than 5 rows"):
        effects.make("bias_jump", {"run": "elsewhere"}).suited([data])


def test_a_kink_changes_the_slope_and_a_bump_passes():
    data = ramp(0.2)
    temperature = data.channel("temperature")
    kink = columns("bias_kink", data, at_degc=40.0)[:, 0]
    assert_allclose(kink[temperature > 50.0], temperature[temperature > 50.0] - 40.0, atol=1e-3)
    assert_allclose(kink[temperature < 30.0], 0.0, atol=1e-3)
    bump = columns("bias_kink", data, {"shape": "bump"}, at_degc=40.0, width_degc=4.0)[:, 0]
    assert_allclose(bump, np.exp(-(((temperature - 40.0) / 4.0) ** 2)))
    fixed = columns("bias_kink", data, {"shape": "bump", "width_degc": 4}, at_degc=40.0)[:, 0]
    assert_allclose(fixed, bump)
    shapes = effects.make("bias_kink").shapes()
    assert [(shape.shape, len(shape.parameters)) for shape in shapes] == [("slope", 1)] + 3 * [("bump", 1)]


def test_frost_shows_on_heating_after_it_was_cold_and_only_then():
    data = triangle(250.0, low=-40.0, high=40.0)
    bump = columns("frost", data, at_degc=1.0, width_degc=3.0)[:, 0]
    rising = np.gradient(data.channel("temperature")) > 0
    near = np.abs(data.channel("temperature") - 1.0) < 2.0
    assert bump[rising & near].min() > 0.6
    assert not bump[~rising].any()
    dry = triangle(250.0, low=0.5, high=40.0)  # never cold enough to freeze
    assert not columns("frost", dry, at_degc=1.0, width_degc=3.0).any()


def test_frost_that_melts_begins_suddenly_and_is_largest_a_width_further_up():
    data = triangle(250.0, low=-40.0, high=40.0)
    theta = {"at_degc": 1.0, "width_degc": 3.0}
    melt = effects.make("frost", {"shape": "melt"}).columns(data, theta)[:, 0]
    temperature = data.channel("temperature")
    rising = np.gradient(temperature) > 0
    assert temperature[rising][np.argmax(melt[rising])] == pytest.approx(4.0, abs=0.5)
    assert melt.max() == pytest.approx(1.0, abs=0.02)
    assert not melt[~rising | (temperature < 1.0)].any()
    dry = triangle(250.0, low=1.5, high=40.0)
    assert not effects.make("frost", {"shape": "melt"}).columns(dry, theta).any()


def test_channel_effects_are_products_of_their_channels():
    data = example()
    q, t, a, v = (data.channel(name) for name in ("quadrature", "temperature", "drive", "supply"))
    assert_allclose(columns("quadrature_leakage", data), np.column_stack([q, q * (t - 25.0)]))
    assert columns("quadrature_leakage", data, {"phase_drift": False}).shape[1] == 1
    drive = columns("drive_amplitude", data, {"order": 2})
    assert_allclose(drive[:, 1], drive[:, 0] ** 2)
    assert_allclose(np.ptp(drive[:, 0]), 100.0 * np.ptp(a) / (0.5 * (a.max() + a.min())))
    assert_allclose(columns("supply_voltage", data)[:, 0], v - 0.5 * (v.max() + v.min()))
    assert_allclose(columns("compressor", data)[:, 0], data.channel("compressor"))
    assert 0.0 < columns("compressor", data, {"lag_s": 100.0}).mean() < 1.0


def test_scale_factor_coefficients_are_in_ppm():
    data = example()
    rate, temperature = data.channel("applied_rate"), data.channel("temperature")
    s1 = columns("scale_factor_temperature", data)[:, 1]
    assert_allclose(s1, 3600.0 * rate * 1e-6 * (temperature - 25.0))
    c3 = columns("scale_factor_nonlinearity", data)[:, 2]
    assert_allclose(c3, 3600.0 * rate * 1e-6 * rate**2)
    assert effects.make("scale_factor_temperature", {"constant": False}).physical().labels == ("s1", "s2")
    assert effects.make("scale_factor_nonlinearity", {"order": 2}).physical().units == ("ppm", "ppm per deg/s")


@pytest.mark.parametrize("over", ["applied_rate", "rate"])
def test_a_surface_of_order_five_has_21_coefficients_that_rebuild_its_polynomial(over):
    data = example()
    surface = effects.make("surface", {"over": over}).prepare([data])
    form = surface.physical()
    assert len(form.labels) == 21
    amplitudes = np.random.default_rng(0).normal(size=21)
    x, t = data.channel(over), data.channel("temperature")
    powers = np.column_stack([x ** int(label[1]) * t ** int(label[2]) for label in form.labels])
    scaled = amplitudes[0] + surface.columns(data, {}) @ amplitudes[1:]
    assert_allclose(powers @ (form.matrix @ amplitudes), scaled, atol=1e-8)
    assert form.units[form.labels.index("c12")] == f"deg/h/({CHANNELS[over].unit})/degC^2"


def test_frequency_is_a_term_or_a_thermometer():
    data = example()
    term = effects.make("resonance_frequency", {"order": 2}).prepare([data])
    assert not term.moves_abscissa
    amplitudes = np.array([0.3, -0.2])
    constant = term.series.powers()[0] @ amplitudes
    f = data.channel("frequency")
    rebuilt = constant + np.column_stack([f, f**2]) @ (term.physical().matrix[:, 1:] @ amplitudes)
    assert_allclose(rebuilt, term.columns(data, {}) @ amplitudes, atol=1e-3)  # f^2 c2 cancels to 1e-9 of its size
    thermometer = effects.make("resonance_frequency", {"use": "thermometer"}).prepare([data])
    assert thermometer.moves_abscissa
    told = thermometer.abscissa(data, {})
    assert np.abs(told - data.channel("temperature")).max() < 1.5


def test_a_frequency_that_turns_back_is_refused_as_a_thermometer():
    data = ramp(0.2)
    folded = data.with_channel("frequency", 14000.0 - 0.001 * (data.channel("temperature") - 50.0) ** 2)
    with pytest.raises(InputError, match="cannot serve as a thermometer"):
        effects.make("resonance_frequency", {"use": "thermometer"}).prepare([folded])


def test_a_rate_that_steps_within_a_mean_is_squared_before_it_is_averaged():
    time_s = np.arange(300) + 0.5
    rate = np.where((time_s // 20) % 2 == 0, 100.0, -30.0)
    fine = record(time_s, 1.0, applied_rate=rate, temperature=20.0 + time_s / 60.0)
    means = fine.average(30.0)
    squared = columns("scale_factor_nonlinearity", means, {"order": 2, "constant": False})[:, 0]
    assert_allclose(squared, 3600e-6 * np.mean((rate**2).reshape(-1, 30), axis=1))
    warmer = columns("scale_factor_temperature", means, {"order": 1, "constant": False})[:, 0]
    assert_allclose(warmer, 3600e-6 * np.mean((rate * (time_s / 60.0 - 5.0)).reshape(-1, 30), axis=1))
    kept = means.select(np.arange(10) >= 4)
    assert_allclose(columns("scale_factor_nonlinearity", kept, {"order": 2, "constant": False})[:, 0], squared[4:])
    twice = fine.average(15.0).average(30.0)
    assert_allclose(columns("scale_factor_nonlinearity", twice, {"order": 2, "constant": False})[:, 0], squared)
    moved = means.with_channel("temperature", np.full(10, 26.0))  # a lag moves the temperature: no finer one is known
    assert_allclose(
        columns("scale_factor_temperature", moved, {"order": 1, "constant": False})[:, 0],
        3600e-6 * np.mean(rate.reshape(-1, 30), axis=1),
    )


def test_ageing_that_slows_down_is_told_from_a_line():
    """A logarithm of powered time, as outgassing has, beside white noise: one effect, of that law, with its size."""
    rng = np.random.default_rng(4)
    time = (np.arange(700) + 0.5) * 30.0
    temperature = 25.0 + 50.0 * np.sin(5.0 * np.pi * time / time[-1])
    rate = 2e-4 * (temperature - 25.0) ** 2 + 0.6 * np.log1p(time / 3600.0) + rng.normal(0.0, 0.09, time.size)
    still = np.full(700, 25.0), rng.normal(0.0, 0.09, time.size)
    run, static = (
        Dataset(name, time, {"temperature": t, "rate": r}, np.zeros(700, dtype=np.int64), (), 30.0)
        for name, t, r in (("aged", temperature, rate), ("still", *still))
    )
    spline = Model("spline", (effects.make("spline", {"intervals": 12}),))
    wanted = [effects.make(name) for name in ("aging", "warm_up", "creep")]
    answer = diagnose([run], spline, static=static, candidates=wanted)
    (found,) = answer.named
    assert (found.effect, found.options) == ("aging", {"law": "logarithm"})
    assert found.parameters["logarithm"].value == pytest.approx(0.6, abs=0.1)
