"""Effects of one kind of gyro: found in simulated units that share no equation, and never suspected of other kinds."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from bench.analysis.effects import registry
from bench.analysis.effects.catalogue import catalogue
from bench.analysis.effects.model import Model, load_model
from bench.analysis.fit.fitting import fit_model
from bench.base.errors import InputError
from bench.record import Dataset
from drivers.sim.truth import MECHANISMS
from drivers.sim.truth.base import Scene

STEP_S, NODE_S = 30.0, 1.0
WHITE_DPH = 0.02


def unit(name: str, temperature_of, rate_of, hours: float, **numbers) -> Dataset:
    """30 s means of a unit whose bias is a parabola and one mechanism of the simulator, and of white noise."""
    contribute = MECHANISMS[name](**numbers).start(NODE_S, np.random.default_rng(1))
    nodes = round(STEP_S / NODE_S) + 1
    rows, random = [], np.random.default_rng(2)
    for begin in np.arange(0.0, hours * 3600.0, STEP_S):
        time = begin + NODE_S * np.arange(nodes)
        celsius, rate = temperature_of(time), rate_of(np.full(nodes, begin))
        scene = Scene(time, time, NODE_S, celsius, celsius, celsius, celsius, rate, celsius, 0.0, 0.0, 0.0, True)
        rows.append((begin + STEP_S / 2, celsius.mean(), rate.mean(), contribute(scene)[:-1].mean()))
    time, celsius, rate, own = np.array(rows).T
    bias = 3.0 + 0.02 * celsius + 2e-4 * celsius**2 + own + random.normal(0.0, WHITE_DPH, time.size)
    channels = {"rate": 3600.0 * rate + bias, "temperature": celsius, "applied_rate": rate}
    if not np.any(rate):
        del channels["applied_rate"]
    return Dataset("run", time, channels, np.zeros(time.size, dtype=np.int64), interval_s=STEP_S)


def ramps(time):
    hours = [0, 1, 1.5, 2.5, 3, 4, 4.5, 6, 6.3, 8]
    return np.interp(time / 3600.0, hours, [25, 25, -20, -20, 70, 70, 10, 10, 45, 45])


def still(time):
    return np.zeros_like(time)


def steps(time):
    rates = np.array([0.0, 0.05, -0.05, 0.12, -0.12, 0.3, -0.3, 1.0, -1.0, 5.0, -5.0])
    return rates[(time // 300.0).astype(int) % rates.size]


def turns(time):
    return np.where(time < 7200.0, 0.5, -0.3)


def warm(time):
    return 25.0 + 5.0 * np.sin(time / 3000.0)


UNITS = {
    "shupe": (ramps, still, 8.0, {"k_dph_per_degc_per_min": 0.6, "tau_s": 400.0}),
    "lock_in": (warm, steps, 3.0, {"threshold_dps": 0.08}),
    "pattern_angle": (warm, turns, 4.0, {"second_dph": 2.0, "fourth_dph": 0.3}),
}


def made(name: str) -> Dataset:
    temperature, rate, hours, numbers = UNITS[name]
    return unit(name, temperature, rate, hours, **numbers)


@pytest.mark.parametrize("name", UNITS)
def test_the_effect_removes_what_the_mechanism_adds(name):
    run, plain = made(name), registry.make("polynomial", {"order": 2})
    without = fit_model(Model("plain", (plain,)), run, covariance="none", weights="count")
    with_it = fit_model(Model("both", (plain, registry.make(name))), run, covariance="none", weights="count")
    assert without.rms_dph > 10 * WHITE_DPH
    assert with_it.rms_dph < (0.16 * without.rms_dph if name == "shupe" else 1.1 * WHITE_DPH)  # layers are not one lag
    if name == "lock_in":
        assert with_it.theta["lock_in.threshold_dps"] == pytest.approx(0.08, rel=0.01)
        assert with_it.beta[-1] == pytest.approx(1.0, rel=0.01)
    if name == "pattern_angle":
        assert np.hypot(*with_it.beta[-4:-2]) == pytest.approx(2.0, rel=0.03)


def test_only_the_pack_of_its_kind_makes_an_effect_a_suspect():
    def suspects():
        return {one.name for one in catalogue() if one.suspect}

    usual = suspects()
    assert not {"shupe", "lock_in", "pattern_angle"} & usual
    with patch.dict(registry._REGISTRY):
        assert registry.load_effect("fog") == "shupe"
        assert suspects() == usual | {"shupe"}
    assert suspects() == usual
    assert load_model("shupe").effects == (registry.make("shupe"),)  # a model may have it all the same
    with pytest.raises(InputError, match="the name 'shupe' is a built-in effect's"):
        registry.register(type("Mine", (registry.Shupe,), {}), "mine.py:Mine")
