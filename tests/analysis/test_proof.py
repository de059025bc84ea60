"""When unseen data prove an effect: by enough, and by more than noise of any colour does."""

import numpy as np
import pytest

from bench.analysis.diagnosis.proof import LeftOut, legs, prove
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.analysis.noise.whitening import Ratios, Whitener
from tests.support.hidden_runs import hidden_run

ROWS = 1000
TIME = (np.arange(ROWS) + 0.5) * 30.0
SLOW = Whitener.of(Ratios(0.05, 0.02), TIME, 30.0)


def noise(seed):
    return SLOW.colour(np.random.default_rng(seed).normal(size=(ROWS, 1)))[:, 0]


def of(residual):
    return LeftOut("check", residual, np.ones(ROWS))


def test_an_effect_that_is_there_is_proved_and_one_that_is_not_there_is_not():
    shape = 2.0 * np.sin(2.0 * np.pi * TIME / 9000.0)
    there = [prove(of(noise(seed) + shape), of(noise(seed))).proved for seed in range(20)]
    nothing = [prove(of(noise(seed)), of(noise(seed) - shape)).proved for seed in range(20)]
    assert sum(there) >= 19
    assert not any(nothing)


def test_slow_noise_that_happens_to_fall_proves_a_useless_effect_rarely():
    wrong = 0
    for seed in range(200):
        other = 0.5 * np.std(noise(seed)) * np.sign(np.sin(2.0 * np.pi * TIME / 15000.0 + seed))
        left = noise(seed) - noise(seed).mean()
        size = float(other @ left) / float(other @ other)
        wrong += bool(prove(of(left), of(left - 0.5 * np.sign(size) * other)).proved)
    # Half of them are chosen to have the right sign: at two standard deviations 2.3 % of 200 would be 9.
    assert wrong <= 40


def test_a_fall_of_two_percent_is_no_proof_however_certain():
    residual = np.random.default_rng(0).normal(size=ROWS)
    proof = prove(of(residual), of(0.98 * residual))
    assert proof.deviations > 2.0
    assert proof.proved is False
    assert "a fall of 3 % is needed" in proof.words


def test_without_unseen_data_nothing_is_proved_or_refuted():
    proof = prove(LeftOut(reason="the run is one piece"), LeftOut(reason="the run is one piece"))
    assert proof.proved is None
    assert "the run is one piece" in proof.words


@pytest.mark.parametrize(("profile", "count"), [("one_rate", 3), ("short", 6)])
def test_legs_end_where_the_temperature_turns(profile, count):
    run = hidden_run(profile=profile, seed=1)
    label = legs(fit_rows(Model("line", (effects.make("polynomial", {"order": 1}),)), (run,)))
    assert len(np.unique(label)) == count
