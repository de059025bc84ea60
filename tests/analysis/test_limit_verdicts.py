"""Limits: a number with its uncertainty, a word, and the runs that must not be judged at all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.analysis.judging import limits
from bench.analysis.judging.analysis import Analysis
from bench.analysis.judging.judge import judged_by
from bench.analysis.judging.limits import Limit, Limits, judge_limits
from bench.analysis.judging.quantities import quantities
from bench.analysis.judging.quantity import MEANING, Quantity, QuantityName
from bench.analysis.judging.validity import refusals
from bench.base.errors import InputError
from bench.cli import rendering
from bench.commands.analysis import report
from bench.record import Verdict
from tests.support.report_runs import looped, quick
from tests.support.run_folders import make_run, ramp_run

SHIPPED = Path(__file__).parents[2] / "profiles" / "limits" / "vibratory.yaml"


def limit(**changes) -> Limit:
    return Limit(**{"quantity": "residual_rms_dph", "unit": "deg/h", "upper": 1.0, "reason": "test", **changes})


def word(quantity: Quantity, **changes) -> Verdict | None:
    return judge_limits(Limits(name="test", limits=(limit(**changes),)), [quantity]).results[0].verdict


def value(number: float, uncertainty: float = 0.0) -> Quantity:
    return Quantity.expanded("residual_rms_dph", number, uncertainty / 2.0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    return looped(tmp_path_factory.getbasetemp())


@pytest.mark.parametrize(
    ("number", "uncertainty", "marginal", "expected"),
    [
        (0.5, 0.1, 0.2, "PASS"),
        (0.8, 0.2, 0.2, "PASS"),
        (0.81, 0.1, 0.2, "MARGINAL"),
        (0.95, 0.06, 0.0, "MARGINAL"),
        (1.0, 0.0, 0.0, "PASS"),
        (1.01, 0.5, 0.0, "FAIL"),
        (np.nan, 0.0, 0.0, "INVALID"),
    ],
)
def test_word_follows_value_uncertainty_and_marginal_band(number, uncertainty, marginal, expected):
    assert word(value(number, uncertainty), marginal=marginal) == expected


def test_an_interval_whose_end_is_not_known_is_no_pass():
    assert word(Quantity("residual_rms_dph", 0.1)) == "MARGINAL"


def test_what_was_not_measured_is_invalid_only_where_it_is_required():
    other = Quantity.exact("condition", 1.0)
    assert word(other) == "INVALID"
    assert word(other, required=False) is None


@pytest.mark.parametrize(("changes", "said"), [
    ({"upper": -0.5}, "residual_rms_dph is never below 0"),
    ({"upper": 0.5, "marginal": 0.9}, "leave nothing to pass"),
    ({"lower": 0.0, "upper": 1.0, "marginal": 0.5}, "leave nothing to pass"),
])  # fmt: skip
def test_a_limit_that_no_unit_can_pass_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        limit(**changes)
    assert limit(quantity="samples_lost", unit="1", upper=0.0).upper == 0.0
    assert limit(quantity="scale_factor_error_ppm", unit="ppm", upper=-5.0, marginal=9.0).upper == -5.0


def test_data_outside_a_limit_of_their_quality_say_nothing_of_the_unit():
    """A record that does not reach 83 degC is no unit to be put with the rejects, whatever else is wrong."""
    wide = limit(quantity="highest_temperature_degc", unit="degC", lower=83.0, upper=None)
    found = [Quantity.exact("highest_temperature_degc", 46.8), Quantity.exact("residual_peak_dph", 9.0)]
    both = Limits(name="t", limits=(wide, limit(quantity="residual_peak_dph")))
    judged = judge_limits(both, found)
    assert ([one.verdict for one in judged.results], judged.verdict) == (["INVALID", "FAIL"], "INVALID")


@pytest.mark.parametrize(
    ("words", "expected"),
    [((0.1, 0.9), "MARGINAL"), ((0.1, 2.0), "FAIL"), ((0.1, 0.1), "PASS"), ((2.0, np.nan), "INVALID")],
)
def test_the_verdict_is_the_worst_word(words, expected):
    both = Limits(name="t", limits=(limit(marginal=0.2), limit(quantity="residual_peak_dph", marginal=0.2)))
    found = [value(words[0]), Quantity.exact("residual_peak_dph", words[1])]
    assert judge_limits(both, found).verdict == expected
    assert judge_limits(both, found, ["the run is not complete"]).verdict == "INVALID"


def test_an_upper_limit_is_exceeded_by_a_passed_unit_in_at_most_one_of_forty_cases():
    """Truth just outside the limit, measured with normal errors: how often does the rule pass it?"""
    measured = 1.0 + 1e-9 + 0.1 * np.random.default_rng(0).normal(size=20_000)
    passed = [word(value(number, 0.2)) == "PASS" for number in measured.tolist()]
    assert np.mean(passed) < 0.025 + 3 * np.sqrt(0.025 / 20_000)


def test_every_quantity_has_a_unit_and_a_meaning():
    assert set(MEANING) == set(QuantityName.__args__)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{quantity: residual_rms_dpt, unit: deg/h, upper: 1, reason: x}", "did you mean 'residual_rms_dph'"),
        ("{quantity: residual_rms_dph, unit: deg/s, upper: 1, reason: x}", "residual_rms_dph is in 'deg/h'"),
        ("{quantity: residual_rms_dph, unit: deg/h, reason: x}", "neither lower nor upper"),
        ("{quantity: residual_rms_dph, unit: deg/h, lower: 2, upper: 1, reason: x}", "lower 2 is not below upper 1"),
        ("{quantity: condition, unit: '1', lower: 0, upper: 1, marginal: 0.5, reason: x}", "leave nothing to pass"),
        ("{quantity: condition, unit: '1', upper: 1}", "missing key 'reason'"),
    ],
)
def test_a_wrong_limit_is_refused_with_its_line(tmp_path, line, said):
    path = tmp_path / "limits.yaml"
    path.write_text(f"name: mine\nlimits:\n  - {line}\n")
    with pytest.raises(InputError, match=r"limits.yaml:3: ") as error:
        limits.load_limits(path)
    assert said in str(error.value)


@pytest.mark.slow
def test_quantities_of_a_run_are_those_that_were_put_in(whole):
    found = {quantity.name: quantity for quantity in quantities(whole)}
    assert found["bias_span_dph"].value == pytest.approx(whole.bias_span_dph)
    assert found["thermal_hysteresis_dph"].value == pytest.approx(0.8, abs=0.15)
    assert found["residual_rms_dph"].value == whole.best.held_out.rms_dph
    assert found["residual_peak_dph"].value > found["residual_rms_dph"].value
    assert found["angle_random_walk_dprh"].low <= 0.005 <= found["angle_random_walk_dprh"].high
    assert found["lowest_temperature_degc"].value == pytest.approx(-40.0, abs=0.5)
    assert found["samples_lost"].value == 0
    assert "three rates" in found["scale_factor_error_ppm"].reason
    assert all(q.low <= q.value <= q.high for q in found.values() if np.isfinite(q.value) and np.isfinite(q.low))


def test_scale_factor_of_a_turned_unit_is_the_one_that_was_put_in(tmp_path):
    made = ramp_run(loop_dph=0.0)
    columns = made["columns"]
    applied = np.array([0.0, 50.0, -50.0, 100.0, -100.0])[(columns["time"] // 600.0).astype(int) % 5]
    columns["applied_rate"] = applied
    hot = columns["temperature"] - 25.0
    columns["rate"] = columns["rate"] + 3600.0 * applied * (1.0 + 1e-6 * (300.0 + 2.0 * hot + 0.01 * applied))
    found = {quantity.name: quantity for quantity in quantities(quick(make_run(tmp_path / "turned", **made)))}
    assert found["scale_factor_error_ppm"].value == pytest.approx(300.0, abs=1.0)
    assert found["scale_factor_temperature_ppm_per_degc"].value == pytest.approx(2.0, abs=0.02)
    # Even in the rate: 1 ppm of 100 deg/s, less what the curve over temperature takes of it.
    assert 0.3 < found["scale_factor_nonlinearity_ppm"].value < 1.2


def test_scale_factor_at_one_temperature_and_a_bias_that_does_not_contain_it(tmp_path):
    made = ramp_run([("soak", "soak", 25.0, 6000.0)], loop_dph=0.0)
    columns = made["columns"]
    applied = np.array([0.0, 50.0, -50.0, 100.0, -100.0])[(columns["time"] // 300.0).astype(int) % 5]
    columns["applied_rate"] = applied
    columns["rate"] = columns["rate"] + 3600.0 * applied * (1.0 + 1e-6 * 300.0)
    found = {quantity.name: quantity for quantity in quantities(quick(make_run(tmp_path / "turned", **made)))}
    assert found["scale_factor_error_ppm"].value == pytest.approx(300.0, abs=1.0)
    assert "less than 10 degC" in found["scale_factor_temperature_ppm_per_degc"].reason
    assert found["scale_factor_nonlinearity_ppm"].value < 1.0
    assert found["bias_span_dph"].value < 3.0


def test_what_a_static_curve_leaves_of_a_loop_is_refused_as_a_gap_between_the_branches(whole):
    assert any("lacks an effect with memory" in text for text in refusals(whole))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"state": "aborted", "cause": "operator"}, "not complete: aborted (operator)"),
        ({"state": "recovered", "cause": "bench was killed"}, "not complete: recovered"),
    ],
)
def test_a_run_that_is_not_whole_is_invalid(tmp_path, change, said):
    analysis = quick(make_run(tmp_path / "run", **{**ramp_run(loop_dph=0.0), **change}))
    judged = judged_by(analysis, limits.load_limits(SHIPPED))
    assert judged.judgement.verdict == "INVALID"
    assert said in judged.judgement.refusals[0]
    assert not judged.within_limits


def test_coarse_temperature_steps_are_refused(tmp_path):
    made = ramp_run(loop_dph=0.0)
    made["columns"]["temperature"] = np.round(made["columns"]["temperature"] / 8.0) * 8.0
    assert any("steps of 8" in text for text in refusals(quick(make_run(tmp_path / "coarse", **made))))


def test_a_run_in_one_direction_is_refused(tmp_path):
    legs = [("soak", "soak", -20.0, 1200.0), ("up", "ramp", 60.0, 2.0), ("hot", "soak", 60.0, 1200.0)]
    found = refusals(quick(make_run(tmp_path / "up", **ramp_run(legs, loop_dph=0.0))))
    assert any("of cooling" in text for text in found)


def test_a_run_that_visits_each_end_once_may_be_judged(tmp_path):
    """A block that holds an end of the range is left out once: the rest almost reaches it, and the tangent goes on."""
    legs = [("up", "ramp", 50.0, 2.0), ("hot", "soak", 50.0, 240.0), ("down", "ramp", 0.0, 2.0),
            ("cold", "soak", 0.0, 240.0), ("back", "ramp", 40.0, 3.0), ("end", "ramp", 25.0, 1.5)]  # fmt: skip
    analysis = quick(make_run(tmp_path / "once", **ramp_run(legs, loop_dph=0.0)))
    assert not any("outside the range" in text for text in refusals(analysis))


def test_an_extrapolating_and_an_ill_conditioned_fit_are_refused(whole):
    far = replace(whole.best, held_out=replace(whole.best.held_out, out_of_range=0.3))
    assert any("30% of the unseen data" in text for text in refusals(replace(whole, best=far)))
    weak = replace(whole.best, fit=replace(whole.best.fit, condition=1e11))
    assert any("condition" in text for text in refusals(replace(whole, best=weak)))


@pytest.mark.slow
def test_report_writes_the_verdict_and_its_exit_code_is_the_limits(tmp_path):
    run = make_run(tmp_path / "run", **ramp_run(loop_dph=0.0))
    wide = tmp_path / "wide.yaml"
    wide.write_text("name: wide\nlimits: [{quantity: residual_rms_dph, unit: deg/h, upper: 50, reason: any}]\n")
    tight = tmp_path / "tight.yaml"
    tight.write_text("name: tight\nlimits: [{quantity: residual_rms_dph, unit: deg/h, upper: 0.001, reason: none}]\n")
    answers = {path.stem: report(run, ["spline"], (), None, path) for path in (wide, tight)}
    contents = {name: rendering.content(answer) for name, answer in answers.items()}
    assert answers["wide"].exit_code == 0
    assert contents["wide"]["limits"]["verdict"] == "PASS"
    assert contents["wide"]["verdict"] == "adequate"
    assert answers["tight"].exit_code == 1
    assert contents["tight"]["limits"]["verdict"] == "FAIL"
    assert json.loads((run / "limits.json").read_text()) == {"format": 1, **contents["tight"]["limits"]}
    assert "FAIL against limits 'tight'" in rendering.plain(answers["tight"])
    page = (run / "report.html").read_text()
    assert page.index('id="limits"') < page.index('id="profile"')
    assert "FAIL against the limits" in page


def test_shipped_limits_name_quantities_that_exist():
    assert {entry.quantity for entry in limits.load_limits(SHIPPED).limits} <= set(MEANING)
