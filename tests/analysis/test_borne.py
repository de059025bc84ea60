"""What check runs say of a model, as evidence: in white noise n ln(square sum / square sum), and a slow error loses."""

from types import SimpleNamespace

import numpy as np
import pytest

from bench.analysis.diagnosis.borne import Borne
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.diagnosis.proof import LeftOut
from bench.analysis.diagnosis.verdict import Search
from bench.analysis.effects import registry as effects
from bench.analysis.noise.likelihood import Record
from bench.record import Dataset
from benchmarks import cases
from benchmarks.trials import MODEL

ROWS, NOISE = 300, 0.1
FAST = 0.2 * np.where(np.arange(ROWS) % 2, 1.0, -1.0)
TIME = 30.0 * (np.arange(ROWS) + 0.5)
QUIET = Record(TIME, NOISE * np.random.default_rng(2).normal(size=ROWS), np.ones((ROWS, 1)))


def left(seed, *errors):
    noise = NOISE * np.random.default_rng(seed).normal(size=ROWS)
    residual = np.concatenate([noise + error for error in errors])
    return LeftOut("check", residual, np.ones(len(residual)))


def run():
    return Dataset("check", TIME, {"rate": np.zeros(ROWS)}, np.zeros(ROWS, dtype=np.int64), interval_s=30.0)


def test_in_white_noise_the_gain_is_that_of_the_square_sums():
    judge = Borne([run()], (), (-64, -64))
    before, after = left(1, FAST), left(1, 0.0)
    sums = [float(np.sum((each.residual - each.residual.mean()) ** 2)) for each in (before, after)]
    assert judge.gain(before, after) == pytest.approx((ROWS - 1) * np.log(sums[0] / sums[1]), rel=0.05)
    assert judge.gain(after, before) == -judge.gain(before, after)


def test_a_slow_error_costs_more_beside_an_isothermal_run_that_has_none():
    slow = 0.5 * np.sin(TIME / 1500.0)
    alone, beside = (
        Borne([run()], statics, (-64, -64)).gain(left(1, slow), left(1, 0.0)) for statics in ((), (QUIET,))
    )
    assert 0.0 < alone < beside


def test_every_check_run_counts_with_a_constant_of_its_own():
    both = Borne([run(), run()], (), (-64, -64))
    shifted = both.gain(left(1, FAST + 3.0, FAST - 3.0), left(1, 1.0, -1.0))
    assert shifted == pytest.approx(both.gain(left(1, FAST, FAST), left(1, 0.0, 0.0)), rel=1e-6)


def test_without_check_runs_that_both_predict_nothing_is_said():
    assert Borne([], (), (-64, -64)).gain(left(1, 1.0), left(1, 0.0)) == 0.0
    assert Borne([run()], (), (-64, -64)).gain(LeftOut(reason="none"), left(1, 0.0)) == 0.0


@pytest.mark.slow
def test_of_effects_that_the_run_does_not_tell_apart_the_check_run_chooses():
    """One ramp at one rate does not tell a loop from dT/dt; minor loops, on which dT/dt is wrong, do."""
    unit = cases.case(("preisach",), 0.7, 912, cases.ONE_RATE, MODEL)
    run, check, still = unit.run(cases.ONE_RATE), unit.run(cases.LOOPS, 1), unit.quiet(cases.STATIC, 4)
    alone = diagnose([run], MODEL, static=still).found[0]
    assert (alone.effect, "hysteresis" in alone.look_alikes) == ("temperature_rate", True)
    answer = diagnose([run], MODEL, check=[check], static=still)
    assert (answer.verdict, answer.found[0].effect) == ("missing_effect", "hysteresis")
    assert "temperature_rate" not in answer.found[0].look_alikes
    assert "temperature_rate" not in next_experiment(answer, [run], check=[check], static=still).separates


@pytest.mark.parametrize(
    ("has", "borne"), [("temperature_rate", ["thermometer_lag", "hysteresis"]), ("thermal_lag", ["hysteresis"])]
)
def test_a_check_run_alone_finds_no_second_effect_that_moves_the_temperature(monkeypatch, has, borne):
    """A lag of 120 s beside dT/dt: a lag of 211 s and a lead of 77 s, which undo each other, were called missing."""
    offered = {name: effects.make(name) for name in ("thermometer_lag", "hysteresis")}
    search = Search(SimpleNamespace(effects=offered), None, check=[None])
    monkeypatch.setattr("bench.analysis.diagnosis.verdict._acts_again", lambda *_: True)
    monkeypatch.setattr(Search, "_total", lambda self, layout, point, leaders: [50.0] * len(leaders))
    monkeypatch.setattr(Search, "_falls", lambda *_: True)
    layout = SimpleNamespace(rows=SimpleNamespace(model=SimpleNamespace(effects=(effects.make(has),))))
    leaders = [SimpleNamespace(name=name, sized=True) for name in offered]
    assert [one.name for one in search._borne(layout, (0, 0), leaders)] == borne
