"""A run on a rate table: models of the bias are judged beside a scale factor, and a shared term occurs once."""

from __future__ import annotations

import numpy as np
import pytest

from bench.analysis.diagnosis import diagnose as diagnosing
from bench.analysis.diagnosis.compare import beside_rotation, compare, ladder, plain_name
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.improve import add_effect
from bench.analysis.diagnosis.levelling import levelled
from bench.analysis.diagnosis.still import Still
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.model import Model, load_model
from bench.analysis.effects.registry import make
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.fitting import fit_model
from bench.analysis.noise.floor import Floor, noise_floor
from bench.record import Dataset


def turned(temperature, rate_dps, noise_dph=0.1, bias=lambda t: 5.0 + 0.1 * t):
    """An output whose scale factor is 40 ppm wrong at 25 degC, changes by 60 ppm/degC, and bends with the rate."""
    rng = np.random.default_rng(1)
    ppm = 40.0 + 60.0 * (temperature - 25.0) + 0.01 * rate_dps**2
    error = bias(temperature) + 3600e-6 * ppm * rate_dps + noise_dph * rng.standard_normal(temperature.size)
    channels = {"temperature": temperature, "applied_rate": rate_dps, "rate": error + 3600.0 * rate_dps}
    rows = temperature.size
    return Dataset("turned", np.arange(rows) * 30.0, channels, np.zeros(rows, dtype=int), (), 30.0)


def ramp():
    rows = np.arange(1200)
    return turned(25.0 + 40.0 * np.sin(rows / 190.0), np.choose(rows // 10 % 5, [0.0, 60.0, -60.0, 120.0, -120.0]))


def test_models_of_the_bias_are_judged_beside_the_scale_factor():
    data = ramp()
    scores = compare(data, beside_rotation(ladder(), data), 0.1, strict=False).scores
    assert [plain_name(score.model.name) for score in scores] == ["polynomial", "spline"]
    assert all(score.held_out.rms_dph < 0.15 for score in scores)


def test_a_model_with_a_scale_factor_and_a_run_at_rest_stay_as_they_are():
    data, own = ramp(), load_model("scale_factor")
    assert own in beside_rotation([own], data)
    still = turned(np.linspace(0, 50, 300), np.zeros(300))
    assert beside_rotation(ladder(), still) == ladder()


def test_at_one_temperature_the_scale_factor_over_the_rate_is_what_is_judged():
    rows = np.arange(400)
    data = turned(np.full(400, 23.0), np.choose(rows // 10 % 5, [0.0, 60.0, -60.0, 120.0, -120.0]))
    (only,) = beside_rotation(ladder(), data)
    known = {c.key: c.value for c in fit_model(only, data).coefficients}
    assert known["scale_factor_nonlinearity.c1"] == pytest.approx(40.0 - 120.0, abs=0.5)
    assert known["scale_factor_nonlinearity.c3"] == pytest.approx(0.01, abs=1e-4)


@pytest.mark.parametrize(
    "order",
    [
        ("scale_factor_temperature", "scale_factor_nonlinearity"),
        ("scale_factor_nonlinearity", "scale_factor_temperature"),
        ("scale_factor", "scale_factor_temperature", "scale_factor_nonlinearity"),
    ],
)
def test_effects_that_share_a_term_can_be_added_one_after_the_other(order):
    model = Model("cubic", (make("polynomial", {"order": 3}),))
    for name in order:
        model = add_effect(model, name)
    fit = fit_model(model, ramp())
    assert fit.rms_dph == pytest.approx(0.1, rel=0.1)
    known = {c.key.split(".")[1]: c.value for c in fit.coefficients}
    assert known.get("s0", known.get("c1")) == pytest.approx(40.0, abs=1.0)


@pytest.mark.parametrize("ppm", [30.0, -2e6])  # the second: the sign of the table is reversed
def test_a_constant_error_of_the_scale_factor_is_named_as_that_and_not_as_one_that_changes(ppm):
    """The answer was a nonlinearity whose own terms were zero within their uncertainty."""
    data = ramp()
    rate, temperature = data.channel("applied_rate"), data.channel("temperature")
    noise_dph = 0.1 * np.random.default_rng(2).standard_normal(len(data))
    error = 5.0 + 0.1 * temperature + 3600e-6 * ppm * rate + noise_dph
    plain = data.with_channel("rate", error + 3600.0 * rate)
    (found,) = diagnose([plain], Model("cubic", (make("polynomial", {"order": 3}),))).found
    assert found.effect == "scale_factor"
    s0 = found.parameters["s0"]
    assert abs(s0.value - ppm) < 3.0 * s0.std + 1e-9 * abs(ppm)
    assert not found.look_alikes


RATES = [0.0, 60.0, -60.0, 120.0, -120.0]


@pytest.fixture(scope="module")
def isothermal():
    """Six hours at 25 degC with the same noise: at rest, and on a table that changes its rate every minute."""
    rows = np.arange(720)
    return tuple(turned(np.full(720, 25.0), rate) for rate in (np.zeros(720), np.choose(rows // 2 % 5, RATES)))


def test_an_isothermal_run_that_turned_tells_the_noise_as_one_at_rest_does(isothermal):
    resting, turning = isothermal
    floors = [noise_floor([resting], 30.0, one).floor_dph for one in isothermal]
    assert floors[1] == pytest.approx(floors[0], rel=0.05)
    steps = [np.std(Still.of(one, 30.0).record.steps(30.0)) for one in isothermal]
    assert steps[1] == pytest.approx(steps[0], rel=0.05)
    assert "at one rate" in noise_floor([turning], 30.0).reason, "the soaks of a run are too short to tell"


def test_the_error_of_a_scale_factor_between_two_rates_is_no_white_noise(isothermal):
    data, noise = ramp(), np.random.default_rng(2).normal(0.0, 0.1, 1200)
    data = data.with_channel("rate", 3600.0 * data.channel("applied_rate") * (1.0 + 40e-6) + noise)
    fit = fit_model(load_model("polynomial"), data)
    rows = fit_rows(fit.model, (data,), [np.isfinite(residual) for residual in fit.residuals])
    layout = Layout(rows, np.array(list(fit.theta.values())), Still.of(isothermal[0], 30.0))
    assert levelled(layout) == (layout, "")


def test_a_floor_that_the_isothermal_run_does_not_tell_is_said_with_its_reason(isothermal, monkeypatch):
    monkeypatch.setattr(diagnosing, "noise_floor", lambda *_, **__: Floor(reason="no stretch of it"))
    case = diagnosing._Case.of((ramp(),), load_model("spline"), isothermal[0], None, np.nan)
    assert "the isothermal run turned does not tell the noise floor: no stretch of it" in case.notes
