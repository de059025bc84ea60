"""Limits of what a laboratory computes itself: by formulas of quantities, coefficients and channels."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from bench.analysis.judging.expressed import Measurements, expressed
from bench.analysis.judging.judge import judged_by
from bench.analysis.judging.limits import Limits, judge_limits, load_limits
from bench.analysis.judging.quantity import Quantity
from bench.base import parse_yaml
from bench.base.errors import InputError
from bench.cli import rendering
from tests.support.report_runs import looped

RMS, SPAN = Quantity("residual_rms_dph", 0.2, 0.18, 0.24), Quantity("bias_span_dph", 4.0, 3.9, 4.1)


def limits(expression, **changes):
    one = {"name": "own", "expression": expression, "unit": "1", "upper": 1.0, "reason": "test", **changes}
    return load_limits(parse_yaml(json.dumps({"name": "t", "limits": [one]}), "limits.yaml"))


def computed(expression, *quantities, measured=None):
    return judge_limits(limits(expression), quantities, measured=measured).results[0].quantity


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    return looped(tmp_path_factory.getbasetemp())


def test_a_formula_of_quantities_has_the_widest_interval_that_theirs_allow():
    found = computed("residual_rms_dph / bias_span_dph", RMS, SPAN)
    assert found.value == pytest.approx(0.05)
    assert found.low == pytest.approx(0.05 - 0.02 / 4 - (0.05 - 0.2 / 4.1))
    assert found.high == pytest.approx(0.05 + 0.04 / 4 + (0.2 / 3.9 - 0.05))
    assert (found.unit, found.meaning) == ("1", "residual_rms_dph / bias_span_dph")


def test_the_interval_is_no_narrower_than_that_of_a_simulation():
    rng = np.random.default_rng(0)
    rms, span = rng.normal(0.2, 0.015, 100_000), rng.normal(4.0, 0.05, 100_000)
    found = computed("sqrt(residual_rms_dph) * bias_span_dph ** 2", Quantity.expanded(RMS.name, 0.2, 0.015),
                     Quantity.expanded(SPAN.name, 4.0, 0.05))  # fmt: skip
    for other in (span, 4.0 + (rms - 0.2) / 0.015 * 0.05):  # apart, and wholly correlated
        low, high = np.quantile(np.sqrt(rms) * other**2, (0.025, 0.975))
        assert found.low <= low + 0.01
        assert found.high >= high - 0.01


def test_an_interval_that_is_not_known_is_no_pass():
    word = judge_limits(limits("residual_rms_dph * 2"), [Quantity("residual_rms_dph", 0.1)]).verdict
    assert word == "MARGINAL"


@pytest.mark.parametrize(
    ("expression", "reason"),
    [
        ("residual_peak_dph / 2", "residual_peak_dph: not measured by this run"),
        ("condition * 2", "condition: too few rows"),
        ("max(temperature)", "max(temperature) needs the run's data"),
        ("polynomial.a1", "the model has no coefficient 'polynomial.a1'"),
        ("log(0 * residual_rms_dph)", "has no finite value here"),
    ],
)
def test_what_cannot_be_computed_says_why_and_is_invalid(expression, reason):
    found = judge_limits(limits(expression), [RMS, Quantity("condition", reason="too few rows")])
    assert reason in found.results[0].quantity.reason
    assert found.verdict == "INVALID"
    assert judge_limits(limits(expression, required=False), [RMS]).results[0].verdict is None


def test_statistics_of_channels_are_those_of_pandas(analysis):
    data = analysis.dataset
    frame = pd.DataFrame({"t": data.channel("temperature"), "q": data.channel("quadrature")})
    measured = Measurements(data)
    wanted = {
        "max(temperature) - min(temperature)": frame.t.max() - frame.t.min(),
        "mean(quadrature)": frame.q.mean(),
        "rms(quadrature - 0.5)": ((frame.q - 0.5) ** 2).mean() ** 0.5,
        "max(abs(temperature)) / 2 ** 3": frame.t.abs().max() / 8.0,
    }
    for expression, value in wanted.items():
        found = computed(expression, measured=measured)
        assert found.value == pytest.approx(value, rel=1e-12), expression
        assert (found.low, found.high) == (found.value, found.value)


def test_coefficients_of_the_model_have_their_interval(analysis):
    fit = analysis.best.fit
    one = fit.coefficients[1]
    found = computed(one.key.replace("^", "_"), measured=Measurements(analysis.dataset, fit))
    assert (found.value, found.high) == pytest.approx((one.value, one.value + 2 * one.std))
    wrong = computed("polynomial.a99", measured=Measurements(analysis.dataset, fit))
    assert f"the model '{fit.model.name}' has no coefficient 'polynomial.a99'" in wrong.reason


def test_the_verdict_of_a_run_shows_what_the_limits_compute(analysis):
    own = limits("max(temperature) - min(temperature)", name="range_degc", unit="degC", upper=10.0)
    found = judged_by(analysis, own)
    stored = json.loads((analysis.run.path / "limits.json").read_text())
    (one,) = stored["results"]
    assert (one["name"], one["unit"], one["verdict"]) == ("range_degc", "degC", "FAIL")
    assert one["expression"] == "max(temperature) - min(temperature)"
    assert "range_degc" in "\n".join(map(str, rendering.analyse.judged(found.judgement.to_json())))


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("name: a, expression: residual_rms_dpt", "no quantity 'residual_rms_dpt'; did you mean 'residual_rms_dph'?"),
        ("name: a, expression: temperature", "'temperature' is a channel: write min(temperature), max(temperature)"),
        ("name: a, expression: max(temprature)", "'temprature' is not a channel that max can take"),
        ("name: a, expression: max(rate)", "'rate' is not a channel that max can take; a rate is limited by"),
        ("name: a, expression: max(mean(temperature))", "inside max are channels only"),
        ("name: a, expression: max(polynomial.a1)", "inside max are channels only"),
        ("name: a, expression: max(3)", "max(3) has no channel in it"),
        ("name: a, expression: 'lag(temperature, 60)'", "lag is over time: write it inside min, max, mean, rms"),
        ("name: a, expression: '2 + 3'", "'2 + 3' is a number"),
        ("name: a, expression: open('x')", "no function 'open'"),
        ("name: a, expression: polynomial.a1.real()", "no function 'polynomial.a1.real'"),
        ("name: a, expression: (2).real", "is not a coefficient, such as polynomial.a1"),
        ("name: a, expression: 'residual_rms_dph if 1 else 2'", "IfExp is not allowed"),
        ("name: condition, expression: condition * 2", "'condition' is a quantity"),
        ("name: A b, expression: condition", 'limits[0].name is "A b": must match pattern'),
        ("name: a", "give either `quantity`, or `name` and `expression`"),
        ("quantity: condition, name: a, expression: condition", "give either `quantity`, or `name` and `expression`"),
        ("quantity: condition, meaning: x", "condition has a meaning already"),
    ],
)
def test_a_wrong_expression_is_one_line_with_file_and_line(entry, said):
    text = f"name: t\nlimits:\n- {{{entry}, unit: '1', upper: 1, reason: x}}\n"
    with pytest.raises(InputError) as refused:
        load_limits(parse_yaml(text, "limits.yaml"))
    first = str(refused.value).splitlines()[0]
    assert first.startswith("limits.yaml:3: ")
    assert said in first


@pytest.mark.parametrize("text", ["().__class__", "[x for x in (1,)]", "max.__call__(1)", "(lambda: 1)()", "f'{pi}'"])
def test_a_formula_never_runs_code(text):
    with pytest.raises(InputError):
        expressed(text)


def test_a_dotted_name_is_looked_up_among_the_coefficients_only(analysis):
    measured = Measurements(analysis.dataset, analysis.best.fit)
    assert "no coefficient 'polynomial.__class__'" in computed("polynomial.__class__", measured=measured).reason


def test_a_name_stands_once():
    two = [limits("condition").limits[0]] * 2
    with pytest.raises(ValueError, match="own is limited twice"):
        Limits(name="t", limits=tuple(two))
