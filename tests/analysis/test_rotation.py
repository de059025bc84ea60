"""A run on a rate table: models of the bias are judged beside a scale factor, and a shared term occurs once."""

from __future__ import annotations

import numpy as np
import pytest

from bench.analysis.diagnosis.compare import beside_rotation, compare, ladder, plain_name
from bench.analysis.diagnosis.improve import add_effect
from bench.analysis.effects.model import Model, load_model
from bench.analysis.effects.registry import make
from bench.analysis.fit.fitting import fit_model
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
