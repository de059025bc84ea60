"""A cause that no channel records, on a day in which the temperature wanders: what is named is not proved by it."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from bench.analysis.diagnosis.answer import SuspectedEffect, Value
from bench.analysis.diagnosis.decision import decide, explains, with_formulas
from bench.analysis.diagnosis.describing import _doubted
from bench.analysis.diagnosis.diagnose import borne_out, diagnose, proved_first
from bench.analysis.diagnosis.held_out import Unseen, unseen
from bench.analysis.diagnosis.notes import of_check, slow_floor, switching
from bench.analysis.diagnosis.proof import LeftOut, Proof
from bench.analysis.diagnosis.ranking import _beside_stuck
from bench.analysis.diagnosis.sentences import sentence
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.fitting import fit_model
from bench.analysis.noise.likelihood import Record
from bench.analysis.noise.probability import sized
from bench.record.dataset import Dataset

SPLINE = Model("spline", (effects.make("spline", {"intervals": 12}),))
ROWS, STEP_S, TAU_S = 360, 240.0, 900.0
FALLS = Proof("legs", 1.6, 1.1, 12.0)


def day(seed: int) -> Dataset:
    """The output follows the air with a lag; the sun warms it, too, and nothing records the sun."""
    rng = np.random.default_rng(seed)
    hour = (np.arange(ROWS) + 0.5) * STEP_S / 3600.0
    walk = np.cumsum(rng.normal(0.0, 0.1, ROWS))
    air = -13.0 + 8.0 * np.cos(2.0 * np.pi * (hour - 15.0) / 24.0) + walk - np.linspace(walk[0], walk[-1], ROWS)
    late = np.empty(ROWS)
    late[0] = air[0]
    for i in range(1, ROWS):
        late[i] = late[i - 1] + (air[i] - late[i - 1]) * STEP_S / TAU_S
    sun = np.where((hour > 7.0) & (hour < 17.0), np.sin(np.pi * (hour - 7.0) / 10.0), 0.0)
    rate = late + 3.0 * sun + rng.normal(0.0, 0.03, ROWS)
    channels = {"temperature": air, "rate": rate}
    return Dataset("day", 3600.0 * hour, channels, np.zeros(ROWS, dtype=np.int64), (), STEP_S)


@pytest.mark.parametrize("seed", [3, 4])
def test_what_an_unrecorded_cause_resembles_is_no_headline(seed):
    wanted = [effects.make(name) for name in ("thermal_lag", "creep", "hysteresis", "thermometer_hysteresis")]
    answer = diagnose([day(seed)], SPLINE, candidates=wanted)
    assert {suspect.effect for suspect in answer.named} <= {"thermal_lag"}
    assert "creep" not in answer.sentence.split("Suspected")[0].split("nearest")[0]


def test_a_fall_does_not_prove_an_effect_that_another_one_betters_or_that_is_not_determined():
    assert FALLS.proved
    bettered = replace(FALLS, doubt="with creep in its place to 0.24 deg/h")
    assert bettered.proved is False
    assert bettered.words.endswith("changes from 1.60 to 1.10 deg/h, but with creep in its place to 0.24 deg/h")
    assert replace(FALLS, before_dph=np.nan, doubt="at_degc is on its bound: not determined").proved is None


@pytest.mark.parametrize(("fitted_dph", "floor_dph", "borne"), [
    (1.0, 1.2, True), (1.0, 0.5, False), (0.3, 1.2, False), (0.3, np.nan, False), (1.0, np.nan, True),
])  # fmt: skip
def test_what_is_missing_leaves_no_more_than_twice_the_floor_or_the_error_of_the_fitted_rows(
    fitted_dph, floor_dph, borne
):
    described = SimpleNamespace(proof=FALLS, residuals=(np.full(8, fitted_dph),))
    assert explains(described, floor_dph) is borne


@pytest.mark.parametrize(("periods", "proved"), [(2.3, False), (11.3, True)])
def test_what_follows_the_clock_of_one_run_is_proved_only_where_it_repeats_in_it(periods, proved):
    rng = np.random.default_rng(1)
    time = (np.arange(500) + 0.5) * 30.0
    turn = 2.0 * np.pi * time / time[-1]
    temperature = 25.0 + 50.0 * np.sin(2.5 * turn)
    rate = 2e-4 * (temperature - 25.0) ** 2 + 0.3 * np.sin(periods * turn + 1.0) + rng.normal(0.0, 0.06, 500)
    run = Dataset("one", time, {"temperature": temperature, "rate": rate}, np.zeros(500, dtype=np.int64), (), 30.0)
    answer = diagnose([run], SPLINE, candidates=[effects.make("thermal_lag")])
    best = answer.formulas[0]
    assert best.formula.startswith("k * sin(2*pi*time/")
    assert best.held_out_rms_dph < 0.08
    assert (answer.verdict, answer.proved, best.proof.proved) == ("unknown_effect", proved, proved)
    assert ("only another run can tell whether it repeats" in answer.sentence) is not proved


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_formula_for_a_cause_that_no_channel_records_is_proved_by_one_heating_and_one_cooling(seed):
    """The sun drifts in time alone; into a part of a leg anything smooth is interpolated."""
    rng = np.random.default_rng(seed)
    time = (np.arange(500) + 0.5) * 60.0
    first, other = 2.0 * np.pi * rng.uniform(size=2)
    sun = 0.6 * np.sin(2.0 * np.pi * time / 19000.0 + first) + 0.3 * np.sin(2.0 * np.pi * time / 7600.0 + other)
    temperature = 25.0 + 60.0 * np.interp(time, np.array([0.0, 0.1, 0.5, 0.9, 1.0]) * time[-1], [-1, -1, 1, -1, -1])
    air = temperature + 4.0 * np.sign(np.gradient(temperature)) + rng.normal(0.0, 0.05, time.size)
    segment = np.zeros(time.size, dtype=np.int64)

    def run(name, temperature, air, hidden):
        rate = 2e-4 * (temperature - 25.0) ** 2 + hidden + rng.normal(0.0, 0.13, time.size)
        channels = {"temperature": temperature, "chamber_temperature": air, "rate": rate}
        return Dataset(name, time, channels, segment, (), 60.0)

    level = np.full(time.size, 25.0)
    still = run("still", level, level + rng.normal(0.0, 0.05, time.size), 0.0)
    answer = diagnose([run("one", temperature, air, sun)], SPLINE, static=still)
    assert not answer.proved
    assert not any(formula.proof.proved for formula in answer.formulas)


@pytest.mark.parametrize(("by", "deviations", "block", "period_degc", "proved"), [
    ("legs", 3.8, "lag(", 9.0, False), ("legs", 9.0, "lag(", 9.0, True), ("check", 3.8, "lag(", 9.0, True),
    ("parts of legs", 18.0, "lag(", 9.0, False),
    # Up and down again: etalons of 14 and of 4 periods in all.
    ("parts of legs", 18.0, "sin(", 9.0, True), ("parts of legs", 18.0, "sin(", 31.0, False),
])  # fmt: skip
def test_rows_that_had_a_say_in_the_choice_of_a_formula_prove_it_beyond_what_the_best_of_many_reaches(
    by, deviations, block, period_degc, proved
):
    layout = SimpleNamespace(rows=SimpleNamespace(time=[np.array([0.0, 3e4])]))
    temperature = 63.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, 1000)))
    wave, formula = (
        np.sin(2.0 * np.pi * temperature / period_degc),
        SimpleNamespace(blocks=(SimpleNamespace(text=block),)),
    )
    one = SimpleNamespace(undetermined=(), period_s=0.0, contribution=wave, formula=formula)
    assert _doubted(Proof(by, 0.6, 0.35, deviations), layout, [one]).proved is proved


@pytest.mark.parametrize(("period_s", "told"), [(30.0, True), (50.0, True), (400.0, False), (1e9, False)])
def test_a_compressor_that_switches_within_the_means_is_told(period_s, told):
    """Of one with a period of 30 s it was said that the run would have shown 0.03 deg/h."""
    time = np.arange(7200) + 0.5
    on = (time % period_s < 0.4 * period_s).astype(float).reshape(-1, 30).mean(axis=1)
    run = Dataset("r", np.arange(240) * 30.0, {"compressor": on}, np.zeros(240, dtype=np.int64), (), 30.0)
    assert bool(switching([run])) is told
    assert switching([replace(run, channels={})]) == ()


@pytest.mark.parametrize(("at_bound", "proved"), [(True, False), (False, True)])
def test_what_stands_beside_a_stronger_effect_that_is_not_determined_is_not_proved(at_bound, proved):
    """A loop of 0.1 degC, narrower than the catalogue has: a loop of the thermometer was called missing beside it."""
    width = Value(0.5, "degC", np.nan, (0.5, 0.5), at_bound)
    first, second = (
        SuspectedEffect(
            name, {}, found=True, evidence=evidence, chance=0.0, held_out_before_dph=0.3, held_out_rms_dph=0.12,
            removes=0.9, parameters=values, look_alikes=(), legs=(), model=SPLINE, theta=(), shape=(),
            proof=Proof("check", 0.13, 0.118, 4.0),
        )
        for name, evidence, values in (("hysteresis", 200.0, {"width_degc": width}), ("thermal_lag", 20.0, {}))
    )  # fmt: skip
    found = _beside_stuck([first, second])
    assert found[0] is first
    assert found[1].proved is proved
    assert at_bound == found[1].proof.words.endswith("but beside hysteresis, which is not determined")


def test_a_parameter_that_moves_the_curve_as_a_column_does_is_not_fitted_anew():
    """Of a real loop a formula had one, and the diagnosis ended in an error."""
    fit = fit_model(SPLINE, day(3), covariance="none")
    rows = fit_rows(fit.model, (day(3),), [np.isfinite(fit.residuals[0])])
    plain, same, free = (
        unseen(rows, np.empty(0), (), slopes=slopes).left.residual
        for slopes in (None, np.ones((rows.y.size, 1)), rows.time[0][:, None])
    )
    np.testing.assert_array_equal(plain, same)
    assert not np.allclose(plain, free, equal_nan=True)


@pytest.mark.parametrize(("error_dph", "word"), [(0.21, "undecided"), (1.2, "unknown_effect")])
def test_noise_that_is_not_that_of_the_isothermal_run_is_no_proof_of_a_cause(error_dph, word):
    """Telegraph noise that is faster when warm: the residual is far below the floor, and no probe finds a place."""
    explained = SimpleNamespace(word="unknown_effect", drifts=True, left=(), steps=())
    base = Unseen(error_dph, error_dph, left=LeftOut("check", np.full(9, error_dph), np.ones(9)))
    decision = decide(explained, (), base, base, 0.5, "")
    assert (decision.word, decision.proved) == (word, None)
    assert decision.why.startswith("the run drifts more" if word == "undecided" else "")


def test_an_effect_on_the_bound_of_its_time_constant_gives_way_to_a_formula_that_determines_it():
    """Relaxation within 1500 s: the creep of the catalogue takes half an hour and more."""
    rng = np.random.default_rng(4)
    time = (np.arange(900) + 0.5) * 30.0

    def run(name, turns):
        temperature = 25.0 + 50.0 * np.interp(time, np.linspace(0.0, time[-1], len(turns)), turns)
        behind, level = np.empty(time.size), temperature[0]
        for row, value in enumerate(temperature):
            level += (value - level) * (1.0 - np.exp(-30.0 / 1500.0))
            behind[row] = value - level
        rate = 2e-4 * (temperature - 25.0) ** 2 + 0.012 * behind + rng.normal(0.0, 0.06, time.size)
        segment = np.zeros(time.size, dtype=np.int64)
        return Dataset(name, time, {"temperature": temperature, "rate": rate}, segment, (), 30.0)

    first, check = run("one", [0, 1, 1, -1, -1, 0.5, 0]), run("two", [0, -1, -0.2, -0.2, 0.9, 0.9, -0.5])
    answer = diagnose([first], SPLINE, check=[check], candidates=[effects.make("creep")])
    assert (answer.verdict, answer.nearest) == ("unknown_effect", "creep")
    tau_s = float(re.search(r"lag\(temperature, ([\d.]+)\)", answer.formulas[0].formula)[1])
    assert tau_s == pytest.approx(1500.0, rel=0.1)
    assert answer.formulas[0].proof.proved
    beside = replace(answer.formulas[0], beside=("warm_up",))
    other = with_formulas(answer, (beside,), answer.floor_dph, instead=True)
    assert (other.nearest, other.found) == ("", ()), "an effect that the formula does not stand beside is not named"
    assert "nearest entry" not in sentence(other, drifts=False)


def test_a_formula_with_a_parameter_on_its_bound_is_not_proved_like_an_effect():
    proof = Proof("check", 0.2, 0.11, 5.0)
    (stuck, free) = (SimpleNamespace(undetermined=names, period_s=0.0) for names in (("tau_s",), ()))
    assert _doubted(proof, None, [free, stuck]).words.endswith("but tau_s is on its bound: not determined")
    assert (_doubted(proof, None, [free, stuck]).proved, _doubted(proof, None, [free]).proved) == (False, True)


def test_the_floor_of_a_diagnosis_is_without_what_was_found():
    """The supply wanders in the isothermal run, too: its floor is not what an explained run should reach."""
    rng = np.random.default_rng(6)
    time = (np.arange(700) + 0.5) * 30.0

    def run(name, temperature):
        supply = 5.0 + np.cumsum(rng.normal(0.0, 0.01, time.size))
        rate = 2e-4 * (temperature - 25.0) ** 2 + 8.0 * (supply - 5.0) + rng.normal(0.0, 0.06, time.size)
        channels = {"temperature": temperature, "rate": rate, "supply": supply}
        return Dataset(name, time, channels, np.zeros(time.size, dtype=np.int64), (), 30.0)

    swing = 25.0 + 50.0 * np.sin(5.0 * np.pi * time / time[-1])
    first, check, still = run("one", swing), run("two", -0.8 * swing), run("still", np.full(time.size, 25.0))
    answer = diagnose([first], SPLINE, check=[check], static=still, candidates=[effects.make("supply_voltage")])
    assert [suspect.effect for suspect in answer.named] == ["supply_voltage"]
    assert answer.floor_dph == pytest.approx(0.06, rel=0.2)
    (note,) = [note for note in answer.notes if "has a part of the effects found" in note]
    assert f"and {answer.floor_dph:.4f} without" in note


def unknown(**told):
    """What a sentence is made of, where the verdict is an unknown effect."""
    usual = {"formulas": (), "unexplained": (), "noise_finding": "", "nearest": "", "floor_ratio": np.nan}
    return SimpleNamespace(verdict="unknown_effect", **(usual | told))


def test_the_nearest_entry_is_the_one_that_the_sentence_names():
    first, other = (
        SimpleNamespace(effect=name, options={}, parameters={}, proof=FALLS, proved=True)
        for name in ("partial_range", "hysteresis")
    )
    answer = unknown(found=(first, other), nearest="hysteresis", floor_dph=0.1)
    assert "The nearest entry of the catalogue is hysteresis: with it" in sentence(answer, drifts=False)


@pytest.mark.parametrize(("error_dph", "asked"), [(1.5, True), (0.15, False)])
def test_a_check_run_that_is_quite_unlike_the_run_is_asked_about(error_dph, asked):
    """Its rate was in deg/s, under a header that says deg/h."""
    base = Unseen(error_dph, error_dph, left=LeftOut("check", np.full(9, error_dph), np.ones(9)))
    assert any("is it of this unit" in note for note in of_check(base, base, 0.1)) is asked


@pytest.mark.parametrize(("walk_dph", "said"), [(0.02, True), (0.0, False)])
def test_a_floor_that_is_slow_for_the_most_part_may_hold_a_cause_that_no_channel_records(walk_dph, said):
    rng = np.random.default_rng(3)
    time = 30.0 * np.arange(400)
    noise = rng.normal(0.0, 0.05, time.size) + np.cumsum(rng.normal(0.0, walk_dph, time.size))
    problem = SimpleNamespace(statics=[Record(time, noise, np.ones((time.size, 1)))], interval_s=30.0)
    (note,) = slow_floor(problem, float(np.std(noise))) or ("",)
    assert note.startswith("most of the noise floor is slow, its white part is 0.05") is said


def test_what_was_found_beside_a_drift_and_raises_the_error_is_not_said_to_lower_it():
    proof = replace(FALLS, after_dph=3.94, deviations=-5.0)
    lag = SimpleNamespace(
        effect="thermal_lag", options={}, parameters={}, scored=True, proof=proof, removes=0.0, proved=False
    )
    answer = unknown(found=(lag,), noise_finding="the run drifts")
    text = sentence(answer, drifts=True)
    assert "lowers" not in text
    assert "thermal_lag: the error on legs left out changes from 1.60 to 3.94 deg/h, a fall of 3 % is needed" in text


def test_what_was_found_beside_a_drift_is_told_with_its_proof():
    """The table below the sentence names it: the catalogue explains that part."""
    jump = SimpleNamespace(
        effect="bias_jump", options={}, parameters={}, scored=True, proof=FALLS, removes=np.nan, proved=True
    )
    answer = unknown(found=(jump,), noise_finding="the run drifts")
    text = sentence(answer, drifts=True)
    assert text.startswith("Beside bias_jump the model lacks something")
    assert "Adding bias_jump lowers the error on legs left out from 1.60 to 1.10" in text


@pytest.mark.parametrize(("other", "doubted"), [((), False), (("supply_voltage",), True)])
def test_a_jump_that_something_else_explains_as_well_is_not_proved_by_legs_of_the_only_run(other, doubted):
    """The supply jumps at the same time; its voltmeter is noisy, so that a jump in time fits a little better."""
    rng = np.random.default_rng(5)
    time = (np.arange(600) + 0.5) * 30.0
    temperature = 25.0 + 50.0 * np.sin(5.0 * np.pi * time / time[-1])
    jump = time > 8500.0
    rate = 2e-4 * (temperature - 25.0) ** 2 + 0.25 * jump + rng.normal(0.0, 0.09, time.size)
    channels = {
        "temperature": temperature,
        "rate": rate,
        "supply": 5.0 + 0.1 * jump + rng.normal(0.0, 0.006, time.size),
    }
    run = Dataset("one", time, channels, np.zeros(600, dtype=np.int64), (), 30.0)
    answer = diagnose([run], SPLINE, candidates=[effects.make(name) for name in ("bias_jump", *other)])
    best = answer.suspects[0]
    assert (best.effect, best.look_alikes) == ("bias_jump", other)
    assert (answer.verdict, best.proof.proved) == (("undecided", False) if doubted else ("missing_effect", True))
    assert ("only another run can tell it from supply_voltage" in answer.sentence) is doubted


@pytest.mark.parametrize(("after_dph", "deviations", "borne", "evidence", "told"), [
    (0.12, 5.0, 40.0, 1.0, True), (0.126, 0.5, 40.0, 1.0, True), (0.128, 0.5, 40.0, 1.0, False),
    (0.131, -0.5, 0.0, 1.0, False), (0.131, -0.5, 40.0, -1.0, False), (0.17, -4.0, 40.0, 1.0, False),
    (np.nan, np.nan, 0.0, 20.0, True), (0.122, 1.8, 0.0, 86.0, True), (0.122, 1.8, 0.0, 20.0, False),
    (0.128, 1.8, 0.0, 86.0, False),
])  # fmt: skip
def test_a_formula_that_check_runs_bear_by_their_evidence_is_told_where_their_error_falls(
    after_dph, deviations, borne, evidence, told
):
    """Slow noise of a check run moves its error as much as a small effect does; it does not move the evidence.

    Of a sine of evidence 86 that lowered the error on parts of legs by 7 %, by 1.8 deviations, nothing was told.
    """
    proof = Proof("check", 0.13, after_dph, deviations)
    assert borne_out(SimpleNamespace(proof=proof, borne=borne, evidence=evidence, caution="")) is told


@pytest.mark.parametrize(("proof", "told"), [
    (Proof(reason="a single part of the run determines it"), False), (Proof("legs", 1.6, 1.1, 12.0, doubt="no"), False),
    (Proof("legs", 1.6, 1.1, 12.0), True),
])  # fmt: skip
def test_a_formula_that_cancels_the_model_or_shows_in_one_half_of_the_run_is_told_where_it_is_proved(proof, told):
    """Of a real loop, a product of five factors was the first answer, larger than the bias itself and not judged."""
    one = SimpleNamespace(proof=proof, borne=0.0, evidence=74.0, caution="it cancels a part of the model")
    assert borne_out(one) is told


@pytest.mark.parametrize(("borne", "first"), [(66.0, "best"), (49.0, "proved")])
def test_a_formula_that_is_proved_leads_unless_check_runs_speak_more_for_the_best(borne, first):
    """The errors are the same; the noise of the check run decides which of the two changes is beyond chance."""
    best = SimpleNamespace(name="best", proof=Proof("check", 0.143, 0.129, 1.7), borne=borne, evidence=20.0)
    proved = SimpleNamespace(name="proved", proof=Proof("check", 0.143, 0.129, 2.2), borne=49.0, evidence=18.0)
    assert [one.name for one in proved_first((best, proved))] == [first, ({"best", "proved"} - {first}).pop()]


@pytest.mark.parametrize(("evidence", "first"), [(57.0, "best"), (20.0, "proved")])
def test_legs_that_are_left_out_do_not_put_a_formula_before_one_with_much_more_evidence(evidence, first):
    """They are parts of the run that the evidence is of, and a sine over its time cannot be proved by them."""
    best = SimpleNamespace(
        name="best", proof=Proof("blocks", 0.137, 0.07, 9.0, doubt="no"), borne=0.0, evidence=evidence
    )
    proved = SimpleNamespace(name="proved", proof=Proof("blocks", 0.137, 0.09, 4.0), borne=0.0, evidence=15.0)
    assert proved_first((best, proved))[0].name == first


def test_what_the_check_run_alone_shows_is_said_to_be_of_that_run():
    """A part came loose between the two runs: nothing is wrong with the first, which "cannot tell" nothing."""
    rng = np.random.default_rng(2)
    time = (np.arange(600) + 0.5) * 30.0
    temperature = 25.0 + 50.0 * np.sin(5.0 * np.pi * time / time[-1])
    loop = 0.5 * np.sign(np.gradient(temperature))
    segment = np.zeros(600, dtype=np.int64)
    still = Dataset(
        "still", time, {"temperature": np.full(600, 25.0), "rate": rng.normal(0.0, 0.09, 600)}, segment, (), 30.0
    )
    run, check = (
        Dataset(name, time, {"temperature": temperature, "rate": own + rng.normal(0.0, 0.09, 600)}, segment, (), 30.0)
        for name, own in (("tight", np.zeros(600)), ("loose", loop))
    )
    wanted = [effects.make(name) for name in ("hysteresis", "creep")]
    answer = diagnose([run], SPLINE, check=[check], static=still, candidates=wanted)
    assert (answer.verdict, answer.proved) == ("undecided", False)
    assert answer.sentence.startswith("The check run shows what this run does not")
    together = diagnose([run, check], SPLINE, static=still, candidates=wanted)
    assert "hysteresis" in {suspect.effect for suspect in together.found}


def test_the_size_of_a_sine_is_known_where_its_phase_is_not():
    """A period that is a little off turns the phase at the origin far away, and neither amplitude has a size alone."""
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    covariance = 0.01**2 * np.outer(along, along) + 5.0**2 * np.outer(across, across)
    values = 0.2 * along
    assert np.all(np.abs(values) < 2.0 * np.sqrt(np.diag(covariance)))
    assert sized(values, covariance) > 1.0
    assert sized(np.array([79324.0]), np.array([[641612.0**2]])) < 1.0
    for size in (1, 2, 3):
        root = np.random.default_rng(size).normal(size=(size, size))
        draws = np.random.default_rng(9).normal(size=(4000, size)) @ root.T
        wrongly = np.mean([sized(draw, root @ root.T) > 1.0 for draw in draws])
        assert wrongly == pytest.approx(2.0 * norm.sf(2.0), abs=0.01)
