"""Diagnosis of whole runs of a simulated unit, whose truth integrates states of its own."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bench.acquisition.profile.profile import profile_from_text
from bench.analysis.diagnosis import describing
from bench.analysis.diagnosis.answer import Value
from bench.analysis.diagnosis.compare import compare
from bench.analysis.diagnosis.decision import decide
from bench.analysis.diagnosis.describing import Describer
from bench.analysis.diagnosis.diagnose import _Case, diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.diagnosis.held_out import Unseen
from bench.analysis.diagnosis.improve import add_effect
from bench.analysis.diagnosis.probes import Finding
from bench.analysis.diagnosis.proof import LeftOut, Proof
from bench.analysis.diagnosis.sisters import sister_records
from bench.analysis.diagnosis.slow import structure
from bench.analysis.diagnosis.still import Still
from bench.analysis.diagnosis.verdict import Search
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.judging.diagnosed import improvement_rungs
from bench.analysis.noise.likelihood import NoiseLattice
from bench.base.errors import InputError
from bench.cli.rendering import lines
from bench.commands.results.analyse import Diagnosed
from bench.deliver.report.sections_diagnosis import _advice
from bench.record.dataset import Dataset
from tests.support.analysis_data import LEGS, thermal_cycle, white, with_bias
from tests.support.hidden_runs import INTERVAL_S, NOISE, HiddenUnit, hidden_run

SPLINE = Model("spline", (effects.make("spline", {"intervals": 12}),))
LAG = {"mechanism": "thermal_lag", "tau_s": 200.0}
FEW = [effects.make(name) for name in ("thermal_lag", "temperature_rate", "hysteresis", "supply_voltage", "aging")]
KEYS = {"verdict", "floor_dph", "rms_dph", "held_out_rms_dph", "where", "suspects", "next_experiment"}


@pytest.fixture(scope="module")
def still():
    return hidden_run(profile="static", seed=1000)


@pytest.mark.slow
def test_an_engineer_sees_where_the_model_fails_learns_what_is_missing_adds_it_and_watches_the_error_fall(still):
    unit = HiddenUnit((LAG,)).at_strength(2.0, "short")
    run, unseen = unit.run("short", seed=1), unit.run("minor_loops", seed=2)

    before = diagnose([run], SPLINE, check=[unseen], static=still)
    assert any(place.channel == "dT_dt" or place.note.startswith(("heating", "cooling")) for place in before.where)
    assert (before.verdict, before.proved) == ("missing_effect", True)
    missing = before.suspects[0]
    assert missing.effect == "thermal_lag"
    assert missing.parameters["tau_s"].interval[0] < 200.0 < missing.parameters["tau_s"].interval[1]

    better = add_effect(before.model, missing.effect, missing.options)
    degc, fitted = unseen.channel("temperature"), run.channel("temperature")
    inside = unseen.select((degc >= fitted.min()) & (degc <= fitted.max()))  # beyond it the end slopes decide
    old, new = compare([run], [before.model, better], before.floor_dph, [inside]).scores
    assert new.held_out.rms_dph < 0.8 * old.held_out.rms_dph
    assert diagnose([run], better, check=[unseen], static=still).verdict == "adequate"


def test_nothing_is_missing_from_a_clean_unit_and_the_answer_says_what_it_could_not_have_seen(still):
    wanted = [*FEW, effects.make("scale_factor_temperature")]
    answer = diagnose([hidden_run(profile="short", seed=4)], SPLINE, static=still, candidates=wanted)
    assert (answer.verdict, answer.found, answer.where) == ("adequate", (), ())
    least = {limit.effect: limit for limit in answer.smallest_detectable}
    assert 0.0 < least["temperature_rate"].amplitude < np.inf
    assert "applied_rate" in answer.not_excited["scale_factor_temperature"]


def test_an_effect_that_the_curve_takes_in_has_no_smallest_size_and_the_text_says_so(still):
    wanted = [effects.make(name) for name in ("temperature_rate", "bias_kink")]
    answer = diagnose([hidden_run(profile="short", seed=4)], SPLINE, static=still, candidates=wanted)
    seen = {limit.effect: limit.to_json()["rms_dph"] for limit in answer.smallest_detectable}
    assert seen["bias_kink"] is None
    assert seen["temperature_rate"] < 0.2
    said = "\n".join(line for line in lines(Diagnosed(answer)) if isinstance(line, str))
    assert "bias_kink: not to be seen here: the model takes it in" in said


def test_the_misfit_that_is_left_has_no_part_that_the_effects_found_take_in(still):
    run = hidden_run(profile="short", seed=4)
    case, found = (
        _Case.of((run,), model, still, FEW, None)
        for model in (SPLINE, Model("found", (*SPLINE.effects, effects.make("warm_up"))))
    )
    shape = 1e3 * found.layout.problem.base[:, -1]
    explained = SimpleNamespace(layout=found.layout, left=(Finding("time", 1e-6, 30.0, 4, shape),))
    (place,) = case._unexplained(explained, SimpleNamespace(residuals=found.fit.residuals), case.floor_dph)
    assert place.misfit_dph < 1e-6 * np.sqrt(np.mean(shape**2))


def test_a_jump_is_not_replayed_in_the_check_run(still):
    unit = HiddenUnit(({"mechanism": "bias_jump", "at_s": [6000.0], "step_dph": [0.4]},))
    wanted = [effects.make(name) for name in ("bias_jump", "temperature_rate")]
    check = hidden_run(profile="minor_loops", seed=5)
    answer = diagnose([unit.run("short", seed=1)], SPLINE, check=[check], static=still, candidates=wanted)
    assert [s.effect for s in answer.found] == ["bias_jump"]
    # The curve is not bent by the jump any more: that is what the check run sees of it.
    proof = answer.found[0].proof
    assert proof.after_dph < proof.before_dph
    assert (answer.verdict, answer.proved, answer.found[0].proved) == ("missing_effect", True, True)


def test_an_effect_that_unseen_data_do_not_bear_out_is_suspected_and_not_a_headline(still):
    unit = HiddenUnit(({"mechanism": "temperature_rate"},)).at_strength(1.0, "short")
    opposite = replace(unit, scale=-unit.scale)
    answer = diagnose([unit.run("short", 1)], SPLINE, check=[opposite.run("short", 2)], static=still, candidates=FEW)
    assert (answer.verdict, answer.proved, answer.named) == ("undecided", False, ())
    assert answer.sentence.startswith("The check run contradicts this run, which shows temperature_rate (k1")
    assert "record another run and give it as --check" not in answer.sentence.lower(), "one was given"


def _followed(seed: int, heating_s: float, cooling_s: float) -> Dataset:
    """A day on the chamber, the curve over the temperature of a part that follows with these time constants."""
    rng, time = np.random.default_rng(seed), (np.arange(1040) + 0.5) * 30.0
    turns_h = [0.0, 0.35, 0.85, 1.2, 2.25, 2.6, 4.7, 5.0, 7.1, 7.5, 8.4, 8.67]
    temperature = np.interp(time / 3600.0, turns_h, [25, 25, 85, 85, -40, -40, 85, 85, -40, -40, 15, 25])
    inner, at = np.empty(time.size), 25.0
    for row, outer in enumerate(temperature):
        for _ in range(15):
            at += 2.0 / (heating_s if outer > at else cooling_s) * (outer - at)
        inner[row] = at
    x = (inner - 25.0) / 60.0
    bias = 4.0 + 3.0 * x - 2.2 * x**2 + 1.5 * x**3 + 0.4 * np.sin(inner / 14.0)
    channels = {"temperature": temperature, "rate": bias + 0.11 * rng.normal(size=time.size)}
    return Dataset("slow", time, channels, np.zeros(time.size, dtype=np.int64), (), 30.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_part_that_follows_the_thermometer_for_hours_is_named_though_the_fitted_curve_is_none(seed):
    """The answer was that no effect explains it, and that the run would not show a lag of any size."""
    model = Model("spline", (effects.make("spline", {"intervals": 24}),))
    lag = diagnose([_followed(seed, 8000.0, 8000.0)], model, candidates=FEW).found[0]
    assert lag.effect == "thermal_lag"
    assert abs(lag.parameters["tau_s"].value - 8000.0) < 3.0 * lag.parameters["tau_s"].std


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lag_that_differs_between_heating_and_cooling_is_one_effect(seed):
    """It was a lag and a hysteresis of the thermometer, both proved; and of two time constants that take each other's
    place each was stated as if the other were known.
    """
    model = Model("spline", (effects.make("spline", {"intervals": 24}),))
    wanted = [*FEW, effects.make("thermometer_hysteresis"), effects.make("clock_delay")]
    (lag,) = diagnose([_followed(seed, 100.0, 300.0)], model, candidates=wanted).found
    assert (lag.effect, lag.options) == ("thermal_lag", {"uneven": True})
    for name, truth in (("tau_s", 100.0), ("cooling", 3.0)):
        found = lag.parameters[name]
        assert abs(found.value - truth) < 2.5 * found.std
        assert found.std > 0.05 * truth, "one rate of heating and one of cooling hardly tell them apart"


def _glued(seed: int, began_degc: float) -> Dataset:
    """A day on the chamber of a unit whose glue follows within two hours, and came from another temperature."""
    run = _followed(seed, 1.0, 1.0)
    at, missing, temperature = began_degc, np.empty(len(run)), run.channels["temperature"]
    for row, outer in enumerate(temperature):
        at += (1.0 - np.exp(-30.0 / 7200.0)) * (outer - at)
        missing[row] = at - outer
    return run.with_channel("rate", run.channels["rate"] + 0.02 * missing)


def test_glue_that_came_from_the_cold_creeps_and_does_not_age():
    """It was creep and ageing, both proved; and a creep whose first state is that of the fitted run alone does not
    predict a run that began otherwise.
    """
    run, check = _glued(1, -10.0), _glued(2, 25.0)
    model = Model("spline", (effects.make("spline", {"intervals": 24}),))
    answer = diagnose([run], model, check=[check], candidates=[*FEW, effects.make("creep")])
    (creep,) = answer.named
    assert (creep.effect, creep.options, answer.verdict) == ("creep", {"initial": "free"}, "missing_effect")
    low, high = creep.parameters["tau_h"].interval
    assert low < 2.0 < high
    assert creep.proof.after_dph < 0.12  # with 0.11 of noise
    assert abs(creep.parameters["c"].value + 0.02 * 35.0) < 2.5 * creep.parameters["c"].std
    assert creep.held_out_rms_dph < 0.13
    (score,) = compare([run], [creep.model], 0.11, [check]).scores
    assert score.held_out.rms_dph < 0.13, "what was promised is what the comparison shows"


def test_an_uneven_interval_is_stated_in_the_place_of_a_deviation():
    """2.7 +- 4.9 h reads as if it might be nothing."""
    assert Value(2.7, "h", 4.9, (1.4, 20.6)).words == "2.7 [1.4 ... 21] h"
    assert Value(2.7, "h", 0.5, (1.9, 3.9)).words == "2.70 +- 0.50 h"


@pytest.mark.parametrize("seed", [1, 6, 11])
def test_ageing_is_found_though_the_isothermal_run_ages_too(seed):
    """Its drift there was taken for a random walk, beside which the drift of the run was nothing."""

    def aged(run: Dataset) -> Dataset:
        return run.with_channel("rate", run.channels["rate"] + 0.07 * run.time / 3600.0)

    run, still = aged(HiddenUnit(()).run("two_rates", seed)), aged(HiddenUnit(()).run("static", 5000 + seed))
    answer = diagnose([run], SPLINE, static=still, candidates=FEW)
    assert [suspect.effect for suspect in answer.found] == ["aging"]
    line = answer.found[0].parameters["line"]
    assert abs(line.value - 0.07) < 2.5 * line.std
    assert line.std < 0.02, "of a walk that the isothermal run does not have"


def test_what_follows_a_pause_does_not_spoil_an_effect_with_a_memory():
    """An hour is missing in the middle of a ramp. The answer was a lag of 465 s that cools within 170 s, and a formula
    of -1e10 deg/h beside it.
    """
    whole = _followed(1, 400.0, 400.0)
    kept = np.flatnonzero((whole.time < 4700.0) | (whole.time > 9000.0))
    paused = whole.select(np.isin(np.arange(len(whole)), kept))
    check = _followed(2, 400.0, 400.0)
    model = Model("spline", (effects.make("spline", {"intervals": 24}),))
    for runs, checks in (([paused], [check]), ([check], [paused])):
        answer = diagnose(runs, model, check=checks, candidates=FEW)
        (lag,) = answer.found
        assert (lag.effect, lag.options) == ("thermal_lag", {})
        assert lag.parameters["tau_s"].value == pytest.approx(400.0, abs=30.0)  # a row holds one temperature
        assert lag.held_out_rms_dph < 0.13
        assert not answer.formulas
    assert not any("no data for" in note for note in answer.notes)


def _wavy(seed: int, corners: list[tuple[float, float]]) -> Dataset:
    """A curve that no cubic follows, and dT/dt, over a temperature with these corners [min, degC]."""
    minutes, degc = np.array(corners).T
    time = np.arange(15.0, 60.0 * minutes[-1], 30.0)
    temperature = np.interp(time, 60.0 * minutes, degc)
    x, steep = (temperature - 25.0) / 60.0, np.gradient(temperature, time / 60.0)
    bias = 4.0 + 3.0 * x - 2.2 * x**2 + 1.5 * x**3 + 0.25 * np.sin(temperature / 14.0) + 0.12 * steep
    channels = {"temperature": temperature, "rate": bias + 0.11 * np.random.default_rng(seed).normal(size=len(time))}
    return Dataset(f"wavy {seed}", time, channels, np.zeros(len(time), dtype=np.int64), (), 30.0)


def test_a_curve_that_the_base_does_not_follow_is_a_spline_and_no_kink():
    """A kink has one coefficient and a spline of 24 intervals many, which it paid for: a kink was called missing."""
    run = _wavy(1, [(0, 25), (20, 25), (50, 85), (70, 85), (133, -40), (153, -40), (278, 85), (298, 85), (423, -40)])
    check = _wavy(2, [(0, 25), (20, 25), (50, 70), (97, 0), (114, 50), (141, -30), (171, -30), (231, 30), (341, 80)])
    wanted = [*FEW, *(effects.make(name) for name in ("temperature_rate", "bias_kink"))]
    wanted.append(effects.make("spline", {"intervals": 24}))
    answer = diagnose(
        [run], Model("cubic", (effects.make("polynomial", {"order": 3}),)), check=[check], candidates=wanted
    )
    assert {suspect.effect for suspect in answer.named} == {"spline", "temperature_rate"}
    assert answer.verdict == "missing_effect"


def test_what_lies_beyond_the_end_of_a_parameter_of_the_model_is_missing():
    """The model lets the rate be late, and the temperature is. The answer was that nothing is missing: the slope along
    the delay, which ended on its bound, took the misfit in.
    """
    late = HiddenUnit(({"mechanism": "thermal_lag", "tau_s": 60.0},)).at_strength(1.5, "short")
    model = SPLINE.adding(effects.make("clock_delay", {"late": "temperature"}))
    run, check = late.run("short", seed=1), late.run("minor_loops", seed=2)
    answer = diagnose([run], model, check=[check], candidates=FEW)
    assert answer.found[0].effect == "thermal_lag"
    assert any(note.startswith("clock_delay.delay_s of the model is on its bound, 3") for note in answer.notes)


def test_an_effect_of_the_model_that_the_check_run_does_not_bear_out_is_told():
    unit = HiddenUnit(({"mechanism": "thermal_lag", "tau_s": 60.0},)).at_strength(2.0, "short")
    model = SPLINE.adding(effects.make("thermal_lag")).adding(effects.make("hysteresis"))
    answer = diagnose([unit.run("short", seed=1)], model, check=[unit.run("minor_loops", seed=2)], candidates=FEW[1:2])
    notes = [note for note in answer.notes if note.startswith("the check run does not bear out")]
    assert [note.split()[7] for note in notes] == ["hysteresis"]


def test_spikes_in_a_check_run_speak_against_no_effect(still):
    """Three of a thousand means; the answer was that no effect of the catalogue explains the error."""
    unit = HiddenUnit((LAG,)).at_strength(1.5, "short")
    check = unit.run("minor_loops", 2)
    rate = check.channels["rate"].copy()
    rate[[40, 90, 140]] += [20.0, -20.0, 30.0]
    struck = replace(check, channels={**check.channels, "rate": rate})
    plain, spiked = (
        diagnose([unit.run("short", 1)], SPLINE, check=[one], static=still, candidates=FEW) for one in (check, struck)
    )
    assert spiked.verdict == "missing_effect"
    assert spiked.found[0].proof.after_dph == pytest.approx(plain.found[0].proof.after_dph, rel=0.02)
    assert "rows with spikes in the check runs, left out: 3" in spiked.notes
    assert not any("spikes" in note for note in plain.notes)
    rungs = improvement_rungs(spiked, [unit.run("short", 1)], [struck])
    assert rungs[1].held_out_dph == pytest.approx(spiked.found[0].held_out_rms_dph, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("size", [10.0, 20.0])  # less and more evidence than the lag has
def test_an_effect_beside_another_that_the_check_run_speaks_against_is_not_found(still, size):
    unit = HiddenUnit((LAG,)).at_strength(2.0, "short")

    def supplied(run, dph_per_v):
        own = dph_per_v * (run.channel("supply") - run.channel("supply").mean())
        return replace(run, channels={**run.channels, "rate": run.channels["rate"] + own})

    run, check = supplied(unit.run("short", 1), size), unit.run("minor_loops", 2)
    both = diagnose([run], SPLINE, check=[supplied(check, size)], static=still, candidates=FEW)
    assert {suspect.effect for suspect in both.found} == {"thermal_lag", "supply_voltage"}
    proofs = Proof(), Proof("check", 0.2, 0.1, 9.0)
    first, second = (replace(one, proof=proof) for one, proof in zip(both.found, proofs, strict=True))
    doubted = replace(both, verdict="missing_effect", suspects=(first, second))
    ladder = [rung.name for rung in improvement_rungs(doubted, [run], [check])]
    assert ladder == ["spline", f"+ {second.effect}", f"+ {first.effect}"], "what is proved comes first"
    one = diagnose([run], SPLINE, check=[supplied(check, -size)], static=still, candidates=FEW)
    assert [suspect.effect for suspect in one.found] == ["thermal_lag"]


def test_an_effect_that_makes_up_for_another_is_contradicted_by_the_legs_that_are_left_out(still):
    run = hidden_run(profile="short", seed=1)
    supplied = run.channels["rate"] + 10.0 * (run.channel("supply") - run.channel("supply").mean())
    case = _Case.of((replace(run, channels={**run.channels, "rate": supplied}),), SPLINE, still, FEW, None)
    layout = case.layout.adding(effects.make("thermometer_lag"), (107.0,))
    lag, supply = (
        SimpleNamespace(name=n, theta=t, amplitudes=[1.0])
        for n, t in (("thermal_lag", (300.0,)), ("supply_voltage", ()))
    )
    search = Search(case.offer, case.lattice)
    assert search._contradicted(layout, (0, 0), lag, 10.0)
    assert not search._contradicted(case.layout, (0, 0), supply, 10.0)


@pytest.mark.parametrize("by", ["check", "legs"])
@pytest.mark.parametrize(("left_dph", "drifts", "word"), [
    (0.11, False, "missing_effect"), (0.12, False, "unknown_effect"), (0.11, True, "unknown_effect"),
])  # fmt: skip
def test_what_stands_out_in_the_run_and_does_not_matter_on_unseen_data_leaves_an_effect_proved(
    left_dph, drifts, word, by
):
    explained = SimpleNamespace(word="unknown_effect", drifts=drifts, left=(Finding("drive", 1e-7, 60.0, 4, None),))
    found = SimpleNamespace(found=True, proved=True)
    base, improved = (Unseen(e, left=LeftOut(by, e * np.ones(900), np.ones(900))) for e in (0.15, left_dph))
    decision = decide(explained, [found], base, improved, 0.1, "")
    assert (decision.word, bool(decision.proved)) == (word, word == "missing_effect")


@pytest.mark.parametrize(("less", "name"), [(1.5, "thermal_lag"), (7.0, "creep")])
def test_an_effect_on_its_bound_gives_way_to_one_that_no_data_tell_from_it(still, less, name):
    case = _Case.of((hidden_run(profile="short", seed=1),), SPLINE, still, [effects.make("creep"), *FEW], None)
    stuck, free = (
        SimpleNamespace(name=n, effect=n, evidence=e, on_bound=bound, contribution=np.zeros(len(case.layout.problem.y)))
        for n, e, bound in (("creep", 20.0, True), ("thermal_lag", 20.0 - less, False))
    )
    evidence = SimpleNamespace(point=(0, 0), each_once=lambda: [stuck, free])
    assert Search(case.offer, case.lattice, threshold=3.0)._next(case.layout, evidence, 0).name == name


def test_an_effect_follows_what_is_found_beside_it(still):
    """Found alone, creep of 1 h had taken in a part of a gradient of 700 s."""
    run = hidden_run(profile="short", seed=1)
    degc = run.channel("temperature")

    def lag(tau_s):
        state = np.full(len(degc), degc[0])
        for i in range(1, len(degc)):
            state[i] = state[i - 1] + (degc[i] - state[i - 1]) * (1.0 - np.exp(-INTERVAL_S / tau_s))
        return state

    more = 0.2 * (lag(3600.0) - degc) + 0.2 * (degc - lag(700.0))
    layout = _Case.of((replace(run, channels={**run.channels, "rate": run.channels["rate"] + more}),), SPLINE, still,
                      FEW, None).layout.adding(effects.make("creep"), (2.4,))  # fmt: skip
    beside = layout.adding(effects.make("expression", {"formula": "k * (temperature - lag(temperature, 700))"}), ())
    way = NoiseLattice(beside.problem.records(), INTERVAL_S).white()[0]
    assert beside.settled(way, 1).theta == pytest.approx([1.0], rel=0.1)
    assert beside.settled(way, 0).theta == pytest.approx([2.4])


@pytest.mark.parametrize("more", [False, True])
def test_a_formula_that_only_writes_the_effects_found_in_another_way_is_not_listed(monkeypatch, more):
    one = SimpleNamespace(total=20.0, borne=0.0, one=SimpleNamespace(effect=SimpleNamespace(needs=())))
    model, found = object(), object()
    monkeypatch.setattr(Describer, "_borne", lambda *_: None)
    monkeypatch.setattr(Describer, "_ranked", lambda _, layout, *__: [one] if layout is model else [])
    monkeypatch.setattr(Describer, "_named", lambda *_: (22.0, 0.0))
    monkeypatch.setattr(Describer, "_says_more", lambda *_: more)
    monkeypatch.setattr(Describer, "_listed", lambda *_: ("listed",))
    step = SimpleNamespace(name="hysteresis", suspect=SimpleNamespace(on_bound=False))
    explained = SimpleNamespace(steps=(step,), layout=found, word="unknown_effect")
    answer = Describer(None, (), 0.1)._beside(model, explained, (), SimpleNamespace(answer=tuple))
    assert answer.formulas == (("listed",) if more else ())


@pytest.mark.parametrize(("total", "listed"), [(70.0, ("listed",)), (40.0, ())])
def test_a_formula_takes_the_place_of_an_effect_on_its_bound_beside_those_that_are_determined(
    monkeypatch, total, listed
):
    one = SimpleNamespace(total=total, borne=0.0, one=SimpleNamespace(effect=SimpleNamespace(needs=())))
    model, found, others = object(), object(), object()
    monkeypatch.setattr(describing, "with_found", lambda *_: others)
    monkeypatch.setattr(Describer, "_borne", lambda *_: None)
    monkeypatch.setattr(Describer, "_search", lambda *_: ())
    monkeypatch.setattr(Describer, "_ranked", lambda _, layout, *__: [one] if layout is others else [])
    monkeypatch.setattr(Describer, "_named", lambda *_: (90.0, 0.0))
    monkeypatch.setattr(Describer, "_answer", lambda _, layout, ranked, *__: ("listed",) if ranked else ())
    frost, creep = (
        SimpleNamespace(name=name, suspect=SimpleNamespace(on_bound=bound, evidence=60.0))
        for name, bound in (("frost", True), ("creep", False))
    )
    explained = SimpleNamespace(steps=(frost, creep), layout=found, word="missing_effect")
    answer = Describer(None, (), 0.1)._beside(model, explained, (), SimpleNamespace(answer=tuple))
    assert (answer.formulas, answer.replaces) == (listed, bool(listed))


def test_a_name_that_leaves_much_more_than_the_noise_is_the_nearest_entry_and_not_the_cause(still):
    unit = HiddenUnit(({"mechanism": "thermal_lag", "tau_s": 5400.0},)).at_strength(4.0, "short")
    wanted = [effects.make(name) for name in ("creep", "hysteresis")]
    run, check = unit.run("short", seed=1), unit.run("minor_loops", seed=2)
    answer = diagnose([run], SPLINE, check=[check], static=still, candidates=wanted)
    assert (answer.verdict, answer.nearest) == ("unknown_effect", "creep")
    assert "Missing:" not in answer.sentence


@pytest.mark.slow
def test_without_a_check_run_whole_legs_prove_an_effect_or_nothing_does(still):
    unit = HiddenUnit((LAG,)).at_strength(2.0, "short")
    answer = diagnose([unit.run("short", seed=1)], SPLINE, static=still, candidates=FEW)
    assert (answer.verdict, answer.proved, answer.found[0].proof.by) == ("missing_effect", True, "legs")
    assert answer.to_json()["suspects"][0]["proved"] is True


def test_what_the_catalogue_does_not_have_is_called_unknown_and_shown(still):
    unit = HiddenUnit(({"mechanism": "periodic", "period_s": 1200.0},)).at_strength(1.5, "short")
    answer = diagnose([unit.run("short", seed=1)], SPLINE, static=still, candidates=FEW)
    assert answer.verdict == "unknown_effect"
    assert any(place.note.startswith("period 12") for place in answer.where)
    assert answer.formulas[0].formula.startswith("k * sin(2*pi*time/120")
    assert "no effect of the catalogue explains" in answer.sentence


@pytest.mark.slow
def test_a_cause_that_no_channel_records_needs_the_isothermal_run_to_be_seen(still):
    run = HiddenUnit(({"mechanism": "unlogged_drift"},)).at_strength(2.0, "short").run("short", seed=4)
    with_static, without = (diagnose([run], SPLINE, static=s, candidates=FEW) for s in (still, None))
    assert with_static.verdict == "unknown_effect"
    assert "no channel records" in with_static.noise_finding
    assert any("--static" in note for note in without.notes)


def test_what_an_effect_moves_in_the_isothermal_run_is_not_taken_for_noise():
    """The drive wanders at one temperature, too: without its part the isothermal run has less noise, not the run."""
    unit = HiddenUnit(({"mechanism": "drive_amplitude"},)).at_strength(4.0, "short")
    run, own = unit.run("short", seed=1), unit.run("static", seed=2)
    answer = diagnose([run], SPLINE, static=own, candidates=[*FEW, effects.make("drive_amplitude")])
    assert (answer.verdict, [suspect.effect for suspect in answer.found]) == ("missing_effect", ["drive_amplitude"])
    assert answer.noise_finding == ""


@pytest.mark.slow
def test_a_gradient_whose_size_grows_with_temperature_is_found_with_both_sizes(still):
    def of(seed):
        run = hidden_run(profile="short", seed=seed)
        size = 0.08 + 0.003 * (run.channel("temperature") - 25.0)
        return run.with_channel("rate", run.channel("rate") + size * run.dT_dt)

    answer = diagnose([of(3)], SPLINE, static=still, check=[of(4)], candidates=FEW)
    (found,) = answer.named
    assert found.options["temperature_slope"]
    for name, truth in (("k1", 0.08), ("k2", 0.003)):
        assert found.parameters[name].value == pytest.approx(truth, abs=2.5 * found.parameters[name].std)


@pytest.mark.slow
def test_a_channel_with_gaps_has_a_run_that_tells_its_formulas_apart(still):
    def of(seed):
        run = hidden_run(profile="short", seed=seed)
        supply = run.channel("supply")
        away = (supply - supply.mean()) / supply.std()
        return run.with_channel("rate", run.channel("rate") + 0.15 * away**2)

    run, check = of(3), of(4)
    known = np.isin(np.arange(len(run)), [*range(50, 56), *range(200, 207)], invert=True)
    run = run.with_channel("supply", np.where(known, run.channel("supply"), np.nan))
    answer = diagnose([run], SPLINE, static=still, check=[check], candidates=FEW)
    best = answer.leading
    assert best.formula.startswith("k * (supply - ")
    proposal = next_experiment(answer, [run], check=[check], static=still)
    assert proposal.separates == (best.formula, *best.equivalent)


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "gaps"), [("supply", 24), ("humidity", 2)])
def test_what_acts_through_a_channel_with_gaps_is_found(still, channel, gaps):
    """Supply is a channel that the catalogue needs, humidity is one that only formulas know."""

    def of(seed):
        run = hidden_run(profile="short", seed=seed)
        values = run.channel("supply")
        acts = run.channel("rate") + 0.2 * (values - values.mean()) / values.std()
        others = {name: column for name, column in run.channels.items() if name != "supply"}
        return replace(run, channels={**others, "rate": acts, channel: values})

    run, check = of(3), of(4)
    rows = np.add.outer(np.linspace(5, len(run) - 5, gaps).astype(int), np.arange(3)).ravel()
    known = np.isin(np.arange(len(run)), rows, invert=True)
    run = run.with_channel(channel, np.where(known, run.channel(channel), np.nan))
    answer = diagnose([run], SPLINE, static=still, check=[check], candidates=FEW)
    if channel == "supply":
        assert answer.sentence.startswith("Missing: supply_voltage (k ")
    else:
        assert answer.leading.formula.startswith("k * (humidity - ")
    assert f"rows with gaps in a channel, left out: {len(rows)}" in answer.notes


@pytest.mark.slow
def test_a_channel_that_is_mostly_gaps_is_not_looked_at_and_told(still):
    run = hidden_run(profile="short", seed=3)
    some = np.where(np.arange(len(run)) % 2, run.channel("quadrature"), np.nan)
    answer = diagnose([run.with_channel("humidity", some)], SPLINE, static=still, candidates=FEW)
    assert f"{run.name}: channel 'humidity' has values in only 50 % of the rows" in answer.notes
    assert not any("left out" in note for note in answer.notes)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["leant on", "knocked"])
def test_an_isothermal_run_that_was_disturbed_tells_the_noise_all_the_same(still, how):
    """Somebody leant on the chamber for ten minutes, or knocked at it: the floor was 24 times the residual, and "the
    run drifts more".
    """
    run = hidden_run(profile="short", seed=3)
    since = np.arange(len(still)) - 110.0
    leant, knocked = 3.0 * (since < 20.0), 5.0 * np.exp(-np.clip(since, 0.0, None) / 13.0)
    away = np.where(since >= 0.0, leant if how == "leant on" else knocked, 0.0)
    moved = still.with_channel("rate", still.channel("rate") + away)
    plain, answer = (diagnose([run], SPLINE, static=one, candidates=FEW) for one in (still, moved))
    assert (answer.verdict, answer.noise_finding) == (plain.verdict, plain.noise_finding) == ("adequate", "")
    assert answer.floor_dph == pytest.approx(plain.floor_dph, rel=0.2)


@pytest.mark.slow
def test_a_disturbance_of_the_run_neither_hides_an_effect_nor_is_one(still):
    unit = HiddenUnit(({"mechanism": "temperature_rate"},)).at_strength(2.0, "two_rates")
    run, check = unit.run("two_rates", seed=1), unit.run("two_rates", seed=2)
    away = 5.0 * ((run.time > 3000.0) & (run.time < 3400.0))
    run = run.with_channel("rate", run.channel("rate") + away)
    answer = diagnose([run], SPLINE, check=[check], static=still, candidates=FEW)
    assert [suspect.effect for suspect in answer.named] == ["temperature_rate"]
    rungs = improvement_rungs(answer, [run], [check])
    assert rungs[1].in_sample_dph < 0.8 * rungs[0].in_sample_dph  # the report's figure, too, is without these rows
    (told,) = [note for note in answer.notes if "no channel moves with it" in note]
    first, last = (float(found) for found in re.search(r"from (\d+) to (\d+) s stands out", told).groups())
    assert (first, last) == (pytest.approx(3000.0, abs=90.0), pytest.approx(3400.0, abs=90.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "of", "size"), [("fades", "tau_s", 400.0), ("returns", "lasts_s", 2400.0)], ids=["shock", "40 minutes"]
)
def test_a_shock_and_what_lasts_are_jumps_that_do_not_stay_and_hide_no_effect(still, then, of, size):
    """Formulas of a dozen parameters took their place."""
    unit = HiddenUnit(({"mechanism": "temperature_rate"},)).at_strength(2.0, "two_rates")
    run, check = unit.run("two_rates", seed=1), unit.run("two_rates", seed=2)
    since = np.clip(run.time - 6000.0, 0.0, None)
    away = 4.0 * (run.time > 6000.0) * (np.exp(-since / size) if then == "fades" else since < size)
    run = run.with_channel("rate", run.channel("rate") + away)
    answer = diagnose([run], SPLINE, check=[check], static=still)
    named = {suspect.effect: suspect for suspect in answer.named}
    assert set(named) == {"bias_jump", "temperature_rate"}
    assert named["bias_jump"].options == {"then": then}
    found = named["bias_jump"].parameters[of]
    assert found.value == pytest.approx(size, abs=3.0 * found.std)
    assert found.std < 0.1 * size


@pytest.mark.slow
def test_a_check_run_without_a_channel_does_not_judge_what_acts_through_it(still):
    def of(seed):
        run = hidden_run(profile="short", seed=seed)
        supply = run.channel("supply")
        return run.with_channel("rate", run.channel("rate") + 0.2 * (supply - supply.mean()) / supply.std())

    check = of(4)
    check = replace(check, channels={name: own for name, own in check.channels.items() if name != "supply"})
    answer = diagnose([of(3)], SPLINE, static=still, check=[check], candidates=FEW)
    assert answer.sentence.startswith("Suspected, not proved: supply_voltage (k ")
    assert "channel 'supply' [V] is missing" in answer.sentence


@pytest.mark.slow
def test_runs_of_sister_units_tell_a_slow_cause_from_the_noise(still):
    """One isothermal run leaves open how the noise drifts: ageing as large as the noise hides in it."""
    run = HiddenUnit(({"mechanism": "aging"},)).at_strength(1.0).run("two_rates", seed=5)
    sisters = [hidden_run(profile="static", seed=2000 + number) for number in range(4)]
    wanted = [effects.make("aging"), effects.make("temperature_rate")]
    alone, more = (diagnose([run], SPLINE, static=still, sisters=s, candidates=wanted) for s in ((), sisters))
    assert not alone.found
    assert [suspect.effect for suspect in more.found] == ["aging"]
    assert more.to_json()["sisters"] == [sister.name for sister in sisters]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"angle_random_walk": 0.02}, "has 1.8"),
        ({"bias_instability": 0.15}, "drifts otherwise"),
    ],
)
def test_a_sister_that_is_another_kind_of_unit_is_left_out(still, changed, said):
    sisters = [replace(HiddenUnit(), noise={**NOISE, **noise}).run("static", seed=7) for noise in ({}, changed)]
    own = Still.of(still, INTERVAL_S).record
    kept, (note,) = sister_records(own, sisters, INTERVAL_S)
    assert len(kept) == 1
    assert f"{sisters[1].name} was left out: it {said}" in note


def test_sisters_are_compared_with_the_units_own_isothermal_run(still):
    with pytest.raises(InputError, match="--static"):
        diagnose([hidden_run(profile="short", seed=4)], SPLINE, sisters=[still], candidates=FEW)


def test_a_slow_cause_that_soaks_do_not_have_is_not_called_noise():
    """The noise is free to swallow it; what stands still is not."""
    clean, hidden = (hidden_run(m, "one_rate", 4, 2.0) for m in ([], [{"mechanism": "unlogged_drift"}]))
    still = hidden_run(profile="static", seed=1000)
    assert structure(_Case.of((clean,), SPLINE, still, FEW, None).layout) == ""
    assert "stand out of the noise of the isothermal run" in structure(
        _Case.of((hidden,), SPLINE, still, FEW, None).layout
    )


def test_an_error_far_above_the_floor_is_a_slow_cause_or_the_noise_and_the_run_that_would_tell_is_proposed():
    run = hidden_run([{"mechanism": "unlogged_drift"}], "one_rate", 4, 3.0)
    answer = diagnose([run], SPLINE, candidates=FEW, floor_dph=0.12)
    assert (answer.verdict, answer.proved) == ("undecided", False)
    assert answer.sentence.startswith("A slow cause or the noise: this run cannot tell")
    proposal = next_experiment(answer, [run])
    assert "--static" in proposal.why
    assert profile_from_text(proposal.profile_yaml).segments


def test_adequate_without_an_isothermal_run_says_what_it_cannot_tell():
    answer = diagnose([hidden_run(profile="short", seed=4)], SPLINE, candidates=FEW, floor_dph=0.12)
    assert (answer.verdict, answer.proved) == ("adequate", True)
    assert "A slow cause that no channel records cannot be told from the noise" in answer.sentence


def test_without_a_noise_floor_the_diagnosis_is_not_decided_as_the_report_says():
    run = hidden_run(profile="short", seed=4)
    answer = diagnose([run], SPLINE, candidates=FEW, floor_dph=np.nan)
    assert (answer.verdict, answer.proved) == ("undecided", None)
    assert "noise floor –) fits no effect of the catalogue, and no soak shows how large" in answer.sentence
    proposal = next_experiment(answer, [run])
    assert proposal is not None
    assert proposal.use == "static"


def test_white_noise_that_grows_is_a_finding_about_noise_and_no_missing_effect(still):
    loud = HiddenUnit(noise={"angle_random_walk": 0.02, "bias_instability": 0.03, "rate_random_walk": 0.03})
    answer = diagnose([loud.run("short", seed=3)], SPLINE, static=still, candidates=FEW)
    assert answer.verdict == "adequate"
    assert answer.noise_finding.startswith("white noise of the run is")


def test_two_runs_with_turn_on_biases_of_their_own_are_judged_together(still):
    unit = HiddenUnit(({"mechanism": "temperature_rate"},)).at_strength(1.0, "short")
    first, second = unit.run("short", seed=1), unit.run("short", seed=2)
    second.channels["rate"][:] += 0.7
    answer = diagnose([first, second], SPLINE, static=still, candidates=FEW)
    assert [s.effect for s in answer.found] == ["temperature_rate"]
    assert answer.verdict == "missing_effect"
    proof = answer.found[0].proof  # by legs left out; with the turn-on biases in it, it fell by a few percent
    assert proof.after_dph < 0.8 * proof.before_dph


def test_runs_that_differ_only_by_their_turn_on_biases_say_so(still):
    first, second = HiddenUnit().run("short", seed=1), HiddenUnit().run("short", seed=2)
    second.channels["rate"][:] += 0.7
    answer = diagnose([first, second], SPLINE, static=still, candidates=FEW)
    assert answer.verdict == "adequate"
    left = float(re.search(r"residual \(([\d.]+) deg/h RMS beside a constant of each run", answer.sentence)[1])
    assert left < 1.5 * answer.floor_dph < answer.rms_dph
    (note,) = [note for note in answer.notes if "differ by constants" in note]
    assert float(re.search(r"\+([\d.]+) deg/h", note)[1]) == pytest.approx(0.7, abs=0.05)


@pytest.mark.slow
def test_rivals_that_one_rate_cannot_tell_apart_are_mutual_and_get_a_next_experiment(still):
    unit = HiddenUnit(({"mechanism": "preisach"},)).at_strength(0.9, "one_rate")
    run = unit.run("one_rate", seed=1)
    answer = diagnose([run], SPLINE, static=still, candidates=FEW)
    best = answer.suspects[0]
    assert best.look_alikes
    for rival in (s for s in answer.suspects if s.effect in best.look_alikes):
        assert best.effect in rival.look_alikes
    proposal = next_experiment(answer, [run], static=still).to_json("next.yaml")
    for decides in (True, False):  # a run that would not decide is not proposed
        told = replace(answer, next_experiment={**proposal, "decides": decides})
        said = [line for line in lines(Diagnosed(told)) if isinstance(line, str)]
        done = SimpleNamespace(run=SimpleNamespace(path="r"), manifest=SimpleNamespace(imported=False))
        shown = _advice(done, replace(told, suspects=()))
        assert proposal["why"] in said
        assert [("bench run next.yaml" in text) for text in ("\n".join(said), shown)] == [decides, decides]


def test_the_answer_is_the_json_that_the_command_promises(still):
    answer = json.loads(
        json.dumps(diagnose([hidden_run([LAG], "short", 2)], SPLINE, static=still, candidates=FEW).to_json())
    )
    assert answer.keys() >= KEYS
    assert answer["where"][0].keys() >= {"channel", "from", "to", "rms_dph", "floor_ratio"}
    suspect = answer["suspects"][0]
    assert suspect.keys() >= {"effect", "held_out_rms_dph", "removes", "evidence", "parameters", "look_alikes"}
    assert suspect["parameters"]["tau_s"].keys() >= {"value", "unit", "std"}


def test_an_effect_whose_channel_is_not_there_is_not_testable_and_the_reason_is_said():
    run = hidden_run(profile="short", seed=5)
    del run.channels["quadrature"]
    answer = diagnose([run], SPLINE, candidates=[*FEW[:1], effects.make("quadrature_leakage")])
    assert "no channel 'quadrature'" in answer.not_excited["quadrature_leakage"]


@pytest.mark.parametrize("use", ["static", "check"])
def test_a_run_beside_it_whose_output_is_stuck_is_refused(use):
    run = hidden_run(profile="short", seed=6)
    other = hidden_run(profile="short", seed=7)
    stuck = replace(other, name="other", channels={**other.channels, "rate": np.full(len(other), 3.25)})
    with pytest.raises(InputError, match=r"other: rate is 3\.25 deg/h in every row"):
        diagnose([run], SPLINE, **{use: stuck if use == "static" else [stuck]})


def test_a_static_run_that_does_not_stand_still_is_refused():
    run = hidden_run(profile="short", seed=6)
    with pytest.raises(InputError, match="standing still"):
        diagnose([run], SPLINE, static=run.select(run.direction != 0))


def test_a_spline_that_chooses_few_intervals_is_diagnosed_with_more_so_that_its_misfit_gets_no_name(still):
    run = hidden_run(profile="one_rate", seed=2)
    bare = Model("bare", (effects.make("spline"),))
    answer = diagnose([run], bare, static=still, candidates=FEW)
    assert answer.model.effects[0].intervals >= 12
    assert answer.verdict == "adequate"
    assert any("chose fewer than 12 intervals" in note for note in answer.notes)


def test_a_floor_above_the_error_on_unseen_data_is_said_to_be_an_upper_bound(still):
    run = hidden_run(profile="one_rate", seed=2)
    bare = Model("bare", (effects.make("spline"),))
    high, right = (diagnose([run], bare, static=still, candidates=FEW, floor_dph=floor) for floor in (1.0, None))
    assert any("which is an upper bound here" in note for note in high.notes)
    assert not any("upper bound" in note for note in right.notes)


@pytest.mark.parametrize("rows", [5, 6, 13, 15, 16, 20, 24])
def test_a_short_run_has_an_answer_or_one_line_that_says_how_much_is_needed(rows):
    legs = thermal_cycle(leg_s=30.0 * (rows // len(LEGS) + 1))
    keep = slice(0, rows)
    short = Dataset(
        "short", legs.time[keep], {name: values[keep] for name, values in legs.channels.items()}, legs.segment[keep],
        legs.segments, legs.interval_s,
    )  # fmt: skip
    run = with_bias(short, white(short, 0.1))
    line = Model("line", (effects.make("polynomial", {"order": 1}),))
    if rows < 16:
        with pytest.raises(InputError, match=f"^{rows} means over 30 s are too few .* at least 16"):
            diagnose([run], line, candidates=FEW)
    else:
        assert diagnose([run], line, candidates=FEW).verdict
