"""A jump that a check run has for itself is told and is an error of that run; no proof of an effect counts it."""

import re

import numpy as np
import pytest

from bench.analysis.diagnosis.compare import compare
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.disturbances import undisturbed
from bench.analysis.fit.own_jumps import with_own_jump
from tests.support.hidden_runs import HiddenUnit, hidden_run

SPLINE = Model("spline", (effects.make("spline", {"intervals": 12}),))
FEW = [effects.make(name) for name in ("thermal_lag", "temperature_rate", "supply_voltage", "aging")]
AT_S = 6000.0


@pytest.fixture(scope="module")
def still():
    return hidden_run(profile="static", seed=1000)


@pytest.fixture(scope="module")
def unit():
    return HiddenUnit(({"mechanism": "temperature_rate"},)).at_strength(2.0, "two_rates")


def jumped(run, then, height_dph=5.0):
    since = run.time - AT_S
    after = {
        "stays": np.ones(len(run)),
        "fades": np.exp(-np.clip(since, 0.0, None) / 900.0),
        "returns": since < 2400.0,
    }
    return run.with_channel("rate", run.channel("rate") + height_dph * (since >= 0.0) * after[then])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "said"),
    [("stays", "and stays there"), ("fades", "time constant of 1[3-7]"), ("returns", "returns after 40")],
)
def test_a_jump_of_the_check_run_does_not_hide_what_is_missing(still, unit, then, said):
    """It was "a slow cause or the noise", with an error that does not fall."""
    run, check = unit.run("two_rates", seed=1), unit.run("two_rates", seed=2)
    plain, answer = (
        diagnose([run], SPLINE, check=[one], static=still, candidates=FEW) for one in (check, jumped(check, then))
    )
    assert [one.effect for one in answer.named] == [one.effect for one in plain.named] == ["temperature_rate"]
    assert answer.found[0].proof.after_dph == pytest.approx(plain.found[0].proof.after_dph, rel=0.05)
    (told,) = [note for note in answer.notes if " jumps by " in note]
    assert re.search(said, told)
    assert float(re.search(r"jumps by ([\d.]+)", told)[1]) == pytest.approx(5.0, rel=0.1)
    assert answer.held_out_rms_dph > 2.0 * plain.held_out_rms_dph  # it stays in the error of the check run
    (score,) = compare([run], [SPLINE], answer.floor_dph, jumped(check, then)).scores
    assert score.held_out.rms_dph > 2.0 * score.held_out.shape_dph
    assert score.held_out.shape_dph == pytest.approx(answer.found[0].proof.before_dph, rel=0.05)


@pytest.mark.parametrize("what", ["nothing", "in both", "with a channel", "in its first rows", "four times"])
def test_what_may_be_of_the_unit_is_no_jump_of_the_check_run(unit, what):
    run, check = unit.run("two_rates", seed=1), unit.run("two_rates", seed=2)
    after = check.time >= AT_S
    if what == "in both":
        run, check = jumped(run, "stays"), jumped(check, "stays")
    elif what == "with a channel":
        check = jumped(check, "stays").with_channel("supply", check.channel("supply") + 0.5 * after)
    elif what == "in its first rows":
        check = check.with_channel("rate", check.channel("rate") + 5.0 * (np.arange(len(check)) < 4))
    elif what == "four times":
        check = check.with_channel("rate", check.channel("rate") + 5.0 * ((check.time // 3000.0) % 2 == 1))
    assert with_own_jump(undisturbed(check), [undisturbed(run)]).jump is None


def test_a_fitted_run_that_was_disturbed_did_not_jump(unit):
    run, check = unit.run("two_rates", seed=1), unit.run("two_rates", seed=2)
    away = 5.0 * ((run.time > 3000.0) & (run.time < 3400.0))
    found = with_own_jump(jumped(check, "stays"), [run.with_channel("rate", run.channel("rate") + away)])
    assert found.jump.height_dph == pytest.approx(5.0, rel=0.1)
