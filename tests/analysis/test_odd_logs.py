"""Logs of a simulator of its own, second by second, in circumstances that other tests do not have."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.sentences import sentence
from bench.analysis.effects.model import load_model
from bench.record.dataset import Dataset

SPLINE = load_model("spline")
TWO_RATES = [
    (0, 25),
    (25, 25),
    (104, -30),
    (129, -30),
    (257, 60),
    (282, 60),
    (332, -30),
    (357, -30),
    (388, 25),
    (413, 25),
]
LOOPS = [(0, 25), (30, 25), (50, 50), (84, 5), (111, 40), (157, -20), (184, 15), (222, -30), (237, -30), (306, 60),
         (329, 30), (352, 60), (379, 25), (409, 25)]  # fmt: skip
STILL = [(0, 25), (180, 25)]


def lagging(value, tau_s):
    level, out = value[0], np.empty(len(value))
    for second, each in enumerate(value.tolist()):
        level += (each - level) / tau_s
        out[second] = level
    return out


def relay(value, up, down):
    on, out = False, np.empty(len(value))
    for second, each in enumerate(value.tolist()):
        on = each > up or (on and each > down)
        out[second] = on
    return out


def log(points, seed, of, gaps=()):
    """Means of 30 s of a unit whose bias is `of` its temperature; `gaps` [s] were not recorded."""
    rng = np.random.default_rng(seed)
    minutes, degrees = zip(*points, strict=True)
    second = np.arange(60 * minutes[-1])
    temperature = lagging(lagging(np.interp(second / 60.0, minutes, degrees), 90.0), 150.0)
    rate = of(temperature) + rng.normal(0.0, 0.6, len(second)) + rng.normal(0.0, 0.05)
    felt = temperature + rng.normal(0.0, 0.005, len(second))
    mean = {name: values.reshape(-1, 30).mean(axis=1) for name, values in (("temperature", felt), ("rate", rate))}
    time = 30.0 * np.arange(len(mean["rate"])) + 15.0
    kept = ~np.any([(time > low) & (time < high) for low, high in gaps], axis=0) if gaps else np.ones(len(time), bool)
    channels = {name: values[kept] for name, values in mean.items()}
    return Dataset("log", time[kept], channels, np.zeros(int(kept.sum()), np.int64), (), 30.0)


def curve(temperature):
    x = (temperature - 25.0) / 60.0
    return 12.0 + 68.0 * x - 9.0 * x**2 + 7.0 * x**3 + 1.5 * np.sin(2.5 * x)


@pytest.mark.slow
def test_a_strong_lag_is_named_in_a_run_with_gaps():
    """It was refined coarsely, as its grid promised less than another shape of it, which needed two further effects."""

    def late(temperature):
        return curve(lagging(temperature, 200.0))

    run = log(TWO_RATES, 1, late, gaps=[(3000.0, 4500.0), (12_000.0, 12_900.0)])
    answer = diagnose([run], SPLINE, check=[log(LOOPS, 2, late)], static=log(STILL, 3, late))
    assert (answer.verdict, [one.effect for one in answer.found]) == ("missing_effect", ["thermal_lag"])
    assert answer.found[0].parameters["tau_s"].value == pytest.approx(200.0, abs=4.0)


@pytest.mark.slow
def test_a_formula_takes_the_place_of_what_stood_for_it_beside_a_true_effect():
    """A jump and a part of the range stood for what snaps over, and left half as much again as the noise."""

    def snaps(temperature):
        return curve(temperature) + 0.45 * relay(temperature, 35.0, 20.0) + 15.0 * np.gradient(temperature)

    answer = diagnose([log(TWO_RATES, 4, snaps)], SPLINE, check=[log(LOOPS, 5, snaps)], static=log(STILL, 6, snaps))
    best = answer.formulas[0]
    assert re.fullmatch(r"k \* latch\(temperature, 2[678]\.\d+ \+ [678]\.\d+, 2[678]\.\d+ - [678]\.\d+\)", best.formula)
    assert best.beside == ("temperature_rate",)
    assert best.held_out_rms_dph < 1.2 * answer.floor_dph


@pytest.mark.slow
def test_a_run_that_is_far_quieter_than_its_isothermal_run_has_a_floor():
    """A rest in which the output switches to and fro: the run's white noise was subtracted down to nothing."""
    rest = log(STILL, 7, curve)
    switched = 0.5 * np.sign(np.random.default_rng(8).normal(size=len(rest)))
    rest = replace(rest, channels={**rest.channels, "rate": rest.channels["rate"] + switched})
    answer = diagnose([log(LOOPS, 9, curve)], SPLINE, check=[log(TWO_RATES, 10, curve)], static=rest)
    assert not answer.named
    assert answer.sentence


@pytest.mark.slow
def test_without_a_check_run_too_a_formula_takes_the_place_of_the_effects_that_stood_for_it():
    """A rate of change and a creep on its bound stood for what follows late, beside a true jump."""

    def late_and_jumps(temperature):
        jump = 1.2 * (np.arange(len(temperature)) > 0.44 * len(temperature))
        return curve(temperature) + 0.15 * (lagging(temperature, 200.0) - temperature) + jump

    answer = diagnose([log(TWO_RATES, 11, late_and_jumps)], SPLINE, static=log(STILL, 61, curve))
    best = answer.formulas[0]
    assert re.fullmatch(r"k \* \(temperature - lag\(temperature, (19|20|21)\d(\.\d)?\)\)", best.formula)
    assert best.beside == tuple(one.effect for one in answer.found) == ("bias_jump",)
    assert (answer.verdict, answer.nearest) == ("unknown_effect", "")
    assert "bias_jump (at_h 3.02" in answer.sentence
    assert "explains a part of it" in answer.sentence
    assert best.held_out_rms_dph < 1.15 * answer.floor_dph
    assert "diagnose again" not in answer.sentence
    quieter = replace(answer, floor_dph=0.5 * answer.floor_dph)
    told = f"The error on unseen data is still {quieter.floor_ratio:.2g} x the noise floor: add it and diagnose again."
    assert sentence(quieter, drifts=False).endswith(told)


def test_temperatures_that_were_visited_once_do_not_make_a_verdict():
    """Predicted from the rest, an end of the range is extrapolated: its error was "23 x the noise floor" and the run
    undecided.
    """
    sweep = log([(0, 10), (100, -30), (400, 60)], 22, curve)
    answer = diagnose([sweep], SPLINE, static=log(STILL, 70, curve))
    assert (answer.verdict, answer.proved) == ("adequate", True)
