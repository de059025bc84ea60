"""Formulas of users: what they compute, which names become what, and what is refused (nothing is ever executed)."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect, options_of
from bench.analysis.effects.example import example
from bench.analysis.effects.model import Model, load_model, model_from
from bench.analysis.effects.operators import play, ramp_invariant_lag, slope
from bench.base.errors import InputError


def make(formula, **bounds):
    return effects.make("expression", {"formula": formula, "bounds": bounds})


DATA = example()
T, Q, A = (DATA.channel(name) for name in ("temperature", "quadrature", "drive"))
RATE = 60.0 * slope(DATA.time, T, 60.0)


@pytest.mark.parametrize(
    ("formula", "bounds", "theta", "expected"),
    [
        ("k * dT_dt * quadrature", {}, {}, [RATE * Q]),
        ("quadrature * k", {}, {}, [Q]),
        ("-k*quadrature/2", {}, {}, [-Q / 2]),
        ("k*temperature + m*temperature**2 - k*drive", {}, {}, [T - A, T**2]),
        ("(a + b*(temperature - 25)) * quadrature", {}, {}, [Q, Q * (T - 25)]),
        (
            "k * (temperature - lag(temperature, tau_s))",
            {"tau_s": [10, 1000]},
            {"tau_s": 90.0},
            [T - ramp_invariant_lag(DATA.time, T, 90.0)],
        ),
        ("k * play(temperature, 4) ** 2", {}, {}, [play(T, 4.0) ** 2]),
        ("k * play(temperature, 4 * exp(0 * temperature))", {}, {}, [play(T, 4.0)]),
        ("k*exp(-time/tau)", {"tau": [60, 7200]}, {"tau": 600.0}, [np.exp(-DATA.time / 600.0)]),
        ("k*tanh(w*quadrature)", {"w": [-1, 1]}, {"w": 0.5}, [np.tanh(0.5 * Q)]),
        ("k*direction*sqrt(abs(dT_dt))", {}, {}, [np.where(abs(RATE) < 0.05, 0, np.sign(RATE)) * np.sqrt(abs(RATE))]),
        ("k*sin(2*pi*drive)+m*cos(2*pi*drive)", {}, {}, [np.sin(2 * np.pi * A), np.cos(2 * np.pi * A)]),
        ("k*log(drive)*sign(dT_dt)*compressor", {}, {}, [np.log(A) * np.sign(RATE) * DATA.channel("compressor")]),
    ],
)  # fmt: skip
def test_a_formula_is_the_sum_of_its_amplitudes_times_their_factors(formula, bounds, theta, expected):
    effect = make(formula, **bounds)
    assert isinstance(effect, Effect)
    assert_allclose(effect.columns(DATA, theta), np.column_stack(expected), atol=1e-12)
    assert len(effect.physical().labels) == len(expected)


def test_a_temperature_ahead_of_its_lag_is_the_filtered_rate_of_temperature_but_for_a_factor():
    """As the export says of it: a unit has the rate [degC/min]."""
    ahead = make("k * (temperature - lag(temperature, 60 * 5))").columns(DATA, {})
    rate = effects.make("temperature_rate", {"filter_s": 300.0}).columns(DATA, {})
    assert np.ptp(rate) > 1.0
    assert_allclose(rate, ahead * 60.0 / 300.0, atol=1e-12)


def test_channels_become_needs_and_bounds_become_parameters():
    effect = make("k*dT_dt*lag(quadrature, tau_s)", tau_s=[10, 1000])
    assert effect.needs == ("temperature", "quadrature")
    (tau,) = effect.parameters
    assert (tau.name, tau.low, tau.high, tau.start, tau.log) == ("tau_s", 10.0, 1000.0, pytest.approx(100.0), True)
    assert not make("k*tanh(w*drive)", w=[-1, 1]).parameters[0].log
    assert make("k * time").needs == ()
    assert effect.physical().units == ("deg/h per (dT_dt * lag(quadrature, tau_s))",)


HOSTILE = [
    ("__import__('os').system('true')", "no function"),
    ("k.__class__.__mro__", "Attribute is not allowed"),
    ("(lambda: k)()", "no function"),
    ("[k for k in (1,)]", "ListComp is not allowed"),
    ("k * 'a' * time", "not a number"),
    ("k * True * time", "not a number"),
    ("k * 1j * time", "not a number"),
    ("k * 1e999 * time", "not a number"),
    ("k if time else 2", "IfExp is not allowed"),
    ("k * (time > 3)", "Compare is not allowed"),
    ("k * time[0]", "Subscript is not allowed"),
    ("(k := 3) * time", "NamedExpr is not allowed"),
    ("f'{k}'", "JoinedStr is not allowed"),
    ("k * time; import os", "is not a formula"),
    ("k * time\nimport os", "is not a formula"),
    ("k*time\x00", "is not a formula"),
    ("(" * 190 + "k" + ")" * 190, "is not a formula|multiplies no channel"),
    ("-" * 300 + "k*time", "too long"),
    ("k*time" + "+k*time" * 150, "1 to 1000 characters"),
    ("k*exp(time, out=time)", "takes 1 argument"),
    ("eval(k)", "no function 'eval'"),
    ("k*_x*time", "'_x' is not allowed"),
    ("", "1 to 1000 characters"),
    (None, "1 to 1000 characters"),
    (3, "1 to 1000 characters"),
]


@pytest.mark.parametrize(("formula", "message"), HOSTILE)
def test_anything_but_a_formula_is_refused_in_one_line(formula, message):
    with pytest.raises(InputError, match=message) as caught:
        make(formula)
    assert "\n" not in str(caught.value)


def test_a_term_of_a_name_that_is_no_channel_is_told_from_a_constant():
    with pytest.raises(InputError, match=r"'sin\(T / 4\)' follows no channel: 'T' is none \(temperature, dT_dt and"):
        make("k*sin(T/4)", T=[1, 2])


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("k", "'k' multiplies no channel: that is the model's constant"),
        ("dT_dt", r"has no amplitude; write k \* \(dT_dt\)"),
        ("k*dT_dt + quadrature", r"'quadrature' has no amplitude"),
        ("k*m*quadrature", "'k' and 'm' multiply each other"),
        ("k*quadratur", "did you mean 'quadrature' by 'quadratur'"),
        ("k*exp(a*time)", r"'a' is not simply a factor in 'exp\(a \* time\)': give it bounds, such as bounds: \{a: "),
        ("drive/m", "'m' is not simply a factor"),
        ("k**2*drive", "'k' is not simply a factor"),
        ("k*rate", "the rate is what is modelled"),
        ("k*sin", r"'sin' is a function: write sin\(...\)"),
        ("k*lag(temperature)", "lag takes 2 arguments"),
        ("k*lag(temperature, time)", "second argument of lag is a number or a parameter"),
        ("k*time^2", r"allowed are \+ - \* / and \*\* for powers"),
    ],
)
def test_a_slip_in_a_formula_is_explained(formula, message):
    with pytest.raises(InputError, match=message):
        make(formula)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"tau": [3, 1]}, r"bounds of 'tau' are \[3, 1\]"),
        ({"tau": 3}, "needed are two numbers"),
        ({"tau": ["a", "b"]}, "needed are two numbers"),
        ({"tau": [1, 2], "other": [1, 2]}, "'other', which is not a parameter"),
        ({"tau": [1, 2], "time": [1, 2]}, "'time', which is not a parameter"),
    ],
)
def test_wrong_bounds_are_refused(bounds, message):
    with pytest.raises(InputError, match=message):
        make("k*exp(-time/tau)", **bounds)
    with pytest.raises(InputError, match="bounds is a mapping"):
        effects.make("expression", {"formula": "k*time", "bounds": [1, 2]})


def test_a_value_that_is_not_finite_is_said_and_a_gap_is_not():
    with pytest.raises(InputError, match="no finite value in some rows"):
        make("k*log(-drive)").columns(DATA, {})
    with pytest.raises(InputError, match="no finite value in some rows"):
        make("k*lag(temperature, log(-tau))", tau=[1, 2]).columns(DATA, {"tau": 1.5})
    with pytest.raises(InputError, match="no finite value in some rows"):
        make("k*9**9**9**9*time").columns(DATA, {})
    torn = DATA.with_channel("quadrature", np.where(DATA.time < 300.0, np.nan, Q))
    got = make("k*quadrature").columns(torn, {})[:, 0]
    assert np.isnan(got[DATA.time < 300.0]).all()
    assert np.isfinite(got[DATA.time > 300.0]).all()


def test_a_formula_stands_in_a_model_file(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text(
        'name: m\neffects:\n  - spline: {intervals: 8}\n  - expression: "k * dT_dt * quadrature"\n'
        "  - expression: {formula: a * exp(-time / tau), bounds: {tau: [60, 7200]}}\n",
        encoding="utf-8",
    )
    model = load_model(path)
    assert model.keys == ("spline", "expression", "expression_2")
    assert options_of(model.effects[1]) == {"formula": "k * dT_dt * quadrature"}
    path.write_text(model.to_yaml(), encoding="utf-8")
    assert load_model(path) == model
    assert isinstance(model, Model)


def test_a_wrong_formula_in_a_model_file_is_refused_with_its_line(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text("name: m\neffects:\n  - polynomial\n  - expression: k * quadratur\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"m\.yaml:4: .*did you mean 'quadrature'"):
        load_model(path)
    with pytest.raises(InputError, match="a formula is a text"):
        model_from({"name": "m", "effects": ["expression"]})
