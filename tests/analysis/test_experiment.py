"""The next experiment: what it predicts, that the profile can be run, and that it decides what one ramp cannot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bench.acquisition.profile import profile
from bench.acquisition.run.rehearsal import rehearse
from bench.analysis.diagnosis import experiment
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.discrimination import Discrimination, Expected, between
from bench.analysis.diagnosis.evidence import weigh
from bench.analysis.diagnosis.experiment import next_experiment, propose
from bench.analysis.diagnosis.plan import ChamberLimits, Move, Plan, chamber_limits, minor_loops, plans, repetitions
from bench.analysis.diagnosis.prediction import chamber_model, predicted_record
from bench.analysis.diagnosis.rivals import Rival
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.commands.acquisition import load_station
from bench.mystery import virtual
from bench.record.dataset import Dataset
from drivers.sim.resonator import UnitSettings

RAMP = """name: ramp
start: {temperature_degc: 25, soak_min: 5}
settle: {dwell_min: 2, slope_degc_per_min: 0.3}
segments:
  - {kind: ramp, to_degc: -5, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 10}
  - {kind: ramp, to_degc: 65, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 10}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 1}
"""
CURVE = {"mechanism": "static_bias", "coefficients_dph": [2.0, 3.0, 1.0]}
NOISE = {"angle_random_walk": 0.01, "bias_instability": 0.03, "rate_random_walk": 0.01}
HIDDEN = {
    "thermal_lag": {"mechanism": "thermal_lag", "tau_s": 150.0},
    "temperature_rate": {"mechanism": "temperature_rate", "k_dph_per_degc_per_min": 0.15},
    "hysteresis": {"mechanism": "bouc_wen", "amplitude_dph": 0.2, "length_degc": 8.0},
}
MODEL = Model("curve", (effects.make("spline", {"intervals": 4}),))
LIMITS = ChamberLimits(-20.0, 70.0, 2.0, 1.5, 300.0)


def record(hidden: str, text: str = RAMP, seed: int = 1) -> Dataset:
    settings = UnitSettings.parse({"truth": [CURVE, HIDDEN[hidden]], "noise": NOISE})
    trace = virtual.chamber(profile.profile_from_text(text), seed=seed)
    samples = virtual.unit(settings, trace, seed)
    rows = 10 * 30 * (len(samples.time) // 300)

    def mean(values):
        return np.nanmean(values[:rows].reshape(-1, 300), axis=1)

    wanted = ("rate", "temperature", "chamber_setpoint", "chamber_temperature")
    channels = {name: mean(samples.channels[name]) for name in wanted}
    time = 30.0 * (np.arange(rows // 300) + 0.5)
    return Dataset(f"{hidden} {seed}", time, channels, np.zeros(len(time), dtype=np.int64), (), 30.0)


@pytest.fixture(scope="module")
def runs():
    return {name: record(name) for name in HIDDEN}


def judged(*runs):
    layout = Layout(fit_rows(MODEL, runs), np.zeros(0))
    offered = {name: effects.make(name).suited(runs) for name in HIDDEN}
    found = weigh(layout.problem, [layout.candidate(effect, name) for name, effect in offered.items()], nulls=0)
    rivals = [Rival(s.name, offered[s.name], s.theta, s.evidence) for s in found.suspects]
    return layout, rivals, found.suspects[0].point


def strengthened(rivals):
    return [replace(rival, evidence=40.0) for rival in rivals]


@pytest.mark.parametrize("truth", list(HIDDEN))
def test_the_proposed_run_tells_apart_what_one_ramp_at_one_rate_hardly_does(runs, truth):
    layout, rivals, noise = judged(runs[truth])
    rivals = [rival for rival in rivals if rival.name == truth or rival.name == strongest_other(rivals, truth)]
    proposal = propose(layout, strengthened(rivals), noise, LIMITS)
    assert proposal.predicted_after > 20.0
    assert proposal.predicted_after > 2.0 * proposal.predicted_before
    assert proposal.probability_after > max(0.93, proposal.probability_before)
    second = record(truth, proposal.profile_yaml, seed=2)
    ranked = judged(runs[truth], second)[1]
    assert ranked[0].name == truth
    assert ranked[0].evidence - ranked[1].evidence > 6.0


def test_a_lag_and_a_delay_are_told_apart_by_many_reversals(runs):
    layout, _, noise = judged(runs["thermal_lag"])
    offered = {name: effects.make(name).suited(layout.rows.records) for name in ("thermal_lag", "clock_delay")}
    found = weigh(layout.problem, [layout.candidate(effect, name) for name, effect in offered.items()], nulls=0)
    rated = Discrimination(layout, [Rival(s.name, offered[s.name], s.theta, s.evidence) for s in found.suspects], noise)
    limits = replace(LIMITS, budget_min=480.0)
    gap = {plan.name: rated.expected(plan).gap for plan in plans(limits)}
    best = max(gap, key=gap.get)
    assert "reversals" in best
    assert gap[best] > 2.0 * max(value for name, value in gap.items() if "reversals" not in name)


def strongest_other(rivals, truth):
    return next(rival.name for rival in rivals if rival.name != truth)


def test_what_is_proposed_can_be_run_and_keeps_to_the_chamber(runs):
    layout, rivals, noise = judged(runs["temperature_rate"])
    proposal = propose(layout, strengthened(rivals), noise, LIMITS)
    read = profile.profile_from_text(proposal.profile_yaml)
    ends = [leg.target_degc for leg in read.legs()]
    assert min(ends) >= LIMITS.lowest_degc
    assert max(ends) <= LIMITS.highest_degc
    assert all((leg.rate_degc_per_min or 0.0) <= LIMITS.heating_degc_per_min for leg in read.legs())
    assert proposal.duration_min <= LIMITS.budget_min
    answer = proposal.to_json("next.yaml")
    assert answer["profile"] == "next.yaml"
    assert set(answer["separates"]) == set(HIDDEN)
    assert "probability" in answer["why"]


def test_every_profile_of_the_library_is_one_that_the_bench_reads():
    for plan in plans(LIMITS):
        read = profile.profile_from_text(plan.to_yaml(LIMITS, "why: it is done, and what it's for"))
        assert read.name == plan.name
        nominal = [leg for leg in read.legs() if leg.kind != "step"]
        assert sum(leg.nominal_s for leg in nominal) == pytest.approx(plan.duration_s, abs=60.0)
    names = [plan.name for plan in plans(LIMITS)]
    assert len(set(names)) == len(names) > 5


def test_a_budget_that_nothing_fits_leaves_the_shortest():
    short = replace(LIMITS, budget_min=5.0)
    assert len(plans(short)) == 1


def test_rivals_that_the_runs_should_have_told_apart_may_be_several_or_none(runs):
    run = runs["temperature_rate"]
    slope = np.gradient(run.channel("temperature"), run.time)
    strong = replace(run, channels={**run.channels, "rate": run.channels["rate"] + 300.0 * slope})
    layout, rivals, noise = judged(strong)
    proposal = propose(layout, strengthened(rivals), noise, LIMITS)
    assert proposal.probability_before > 0.97
    assert "another cause, may be at work" in proposal.why
    assert "without it" not in proposal.why


def test_weak_evidence_leaves_more_open_and_gets_a_longer_run(runs):
    quiet = runs["hysteresis"]
    noisy = quiet.channels["rate"] + np.random.default_rng(5).normal(0.0, 0.5, len(quiet))
    loud = replace(quiet, channels={**quiet.channels, "rate": noisy})
    strong, faint = (propose(*judged(run), LIMITS) for run in (quiet, loud))
    assert 0.0 <= faint.probability_before <= faint.probability_after <= faint.after_repeats <= 1.0
    assert faint.probability_before < strong.probability_before
    assert faint.probability_after < strong.probability_after or faint.duration_min > strong.duration_min


def test_what_no_profile_can_tell_is_said_with_the_best_probability(runs):
    layout, rivals, noise = judged(runs["temperature_rate"])
    same = [replace(rivals[0], name="a"), replace(rivals[0], name="b", effect=_Other())]
    proposal = propose(layout, same, noise, LIMITS)
    assert not proposal.decides
    assert proposal.to_json("p")["decides"] is False
    assert "no profile within the limits" in proposal.why


class _Other(type(effects.make("temperature_rate"))):
    """The same equation under another family's name."""

    family = "other"


def test_a_plan_is_repeated_as_often_as_the_budget_allows():
    several = repetitions(minor_loops(LIMITS), replace(LIMITS, budget_min=480.0))
    assert len(several) > 1
    assert several[-1].duration_s <= 480.0 * 60.0
    assert len({plan.name for plan in several}) == len(several)
    for plan in several:
        assert profile.profile_from_text(plan.to_yaml(LIMITS, "why")).name == plan.name


def test_what_is_nearly_tied_is_told_apart_too_and_not_named(runs):
    """One more run, which is to tell the tied ones apart, may bring it back."""
    layout, rivals, noise = judged(runs["temperature_rate"])
    first, third, second = strengthened(rivals)  # the one with nearly as much evidence as the first is the third
    without = propose(layout, [first, second], noise, LIMITS)
    proposal = propose(layout, [first, second, replace(third, tied=False)], noise, LIMITS)
    assert proposal.separates == without.separates == (first.name, second.name)
    plan = minor_loops(LIMITS)
    gaps = [
        Discrimination(layout, each, noise).expected(plan).gaps
        for each in ([first, second], [first, second, replace(third, tied=False)])
    ]
    assert gaps[1].shape == gaps[0].shape
    assert np.all(gaps[1] <= gaps[0] + 1e-9)
    assert np.any(gaps[1] < 0.9 * gaps[0])
    assert propose(layout, [first, replace(third, tied=False)], noise, LIMITS) is None


def test_shapes_of_one_family_need_no_experiment(runs):
    layout, rivals, noise = judged(runs["hysteresis"])
    loop = next(rival for rival in rivals if rival.name == "hysteresis")
    assert propose(layout, [loop, loop], noise, LIMITS) is None


def test_causes_that_the_chamber_does_not_move_are_to_be_moved_by_hand(runs):
    layout, rivals, noise = judged(runs["temperature_rate"])
    supply = Rival("supply_voltage", effects.make("supply_voltage"), (), 30.0)
    proposal = propose(layout, [rivals[0], supply], noise, LIMITS)
    assert "step the supply" in proposal.why
    assert "supply_voltage" in proposal.separates
    assert profile.profile_from_text(proposal.profile_yaml).duration_s > 2 * 3600


def test_what_the_chamber_can_tell_comes_before_what_somebody_has_to_move(runs):
    layout, rivals, noise = judged(runs["temperature_rate"])
    supply = Rival("supply_voltage", effects.make("supply_voltage"), (), 30.0)
    proposal = propose(layout, [*strengthened(rivals), supply], noise, LIMITS)
    assert proposal.use == "run"
    assert proposal.channels == ()
    assert set(proposal.separates) == set(HIDDEN)
    assert proposal.probability_after > proposal.probability_before
    assert "supply_voltage stays open" in proposal.why
    first = propose(layout, [supply, *strengthened(rivals)], noise, LIMITS)
    assert first.use == "by_hand"
    assert first.channels == ("supply",)


def test_standing_still_and_reversing_separates_better_than_the_same_again(runs):
    layout, rivals, noise = judged(runs["temperature_rate"])
    pair = [rival for rival in rivals if rival.name in {"temperature_rate", "hysteresis"}]
    again = Plan("again", "", 25.0, (Move(-5.0, 1.0, 10.0), Move(65.0, 1.0, 10.0), Move(25.0, 1.0)))
    rated = Discrimination(layout, pair, noise)
    alone, repeated, loops = (rated.expected(plan).gap for plan in (None, again, minor_loops(LIMITS)))
    assert alone < repeated < loops


def test_a_rival_is_followed_between_the_points_of_its_grid_too():
    at = np.array([10.0, 20.0, 40.0, 80.0])
    tops = np.array([26.0, 44.0])
    gains = 50.0 - 0.01 * (at[:, None] - tops) ** 2
    assert between(at, gains) == pytest.approx([50.0, 50.0])
    assert between(at, -gains) == pytest.approx((-gains)[2])  # no top between


def test_the_chamber_is_learnt_from_the_run_and_predicts_another(runs):
    run = runs["thermal_lag"]
    model = chamber_model([run])
    assert 60.0 < model.unit.lags_s[0] < 900.0
    plan = minor_loops(LIMITS)
    other = record("thermal_lag", plan.to_yaml(LIMITS, "another run"), seed=3)
    predicted = model.unit.temperature(other.time, other.channels["chamber_setpoint"])
    assert float(np.sqrt(np.mean((predicted - other.channels["temperature"])[60:] ** 2))) < 1.0
    planned = predicted_record([run], plan.setpoint(), 30.0)
    assert np.ptp(planned.channel("temperature")) > 0.8 * np.ptp(plan.setpoint())
    # What follows the gap to the air cannot be predicted from its mean over temperature, which is next to nothing.
    gap = planned.channel("chamber_temperature") - planned.channel("temperature")
    assert np.ptp(gap) > 2.0
    air = model.air.temperature(other.time, other.channels["chamber_setpoint"]) - predicted
    seen = other.channels["chamber_temperature"] - other.channels["temperature"]
    assert np.corrcoef(air[60:], seen[60:])[0, 1] > 0.9


def test_a_run_without_set_point_is_predicted_with_a_typical_chamber(runs):
    run = runs["thermal_lag"]
    bare = replace(run, channels={name: run.channels[name] for name in ("rate", "temperature")})
    assert chamber_model([bare]).unit.lags_s == (300.0, 120.0)


def test_limits_are_what_the_runs_showed(runs):
    limits = chamber_limits([runs["thermal_lag"]])
    assert -6.0 <= limits.lowest_degc <= -2.0
    assert 62.0 <= limits.highest_degc <= 67.0
    assert 0.9 <= limits.heating_degc_per_min <= 1.05
    assert 0.9 <= limits.cooling_degc_per_min <= 1.05


def test_a_plan_takes_as_long_as_the_check_of_its_profile_says_and_no_longer_than_the_budget():
    station, limits = load_station(None), ChamberLimits(-25.0, 85.0, 2.1, 2.0)
    for plan in plans(limits):
        foreseen = rehearse(profile.profile_from_text(plan.to_yaml(limits, "why")), station)[-1].to_s
        assert plan.expected_s == pytest.approx(foreseen, rel=0.1), plan.name
        assert all(one.expected_s <= 60.0 * limits.budget_min for one in repetitions(plan, limits))


def test_a_diagnosis_that_leaves_nothing_open_needs_no_experiment(runs):
    candidates = [effects.make("thermal_lag")]
    found = diagnose([runs["thermal_lag"]], MODEL, candidates=candidates)
    assert next_experiment(found, [runs["thermal_lag"]]) is None


def test_a_diagnosis_with_look_alikes_gets_the_run_that_decides(runs):
    run = runs["hysteresis"]
    found = diagnose([run], MODEL, candidates=[effects.make(name) for name in HIDDEN])
    first = replace(found.suspects[0], look_alikes=tuple(n for n in HIDDEN if n != found.suspects[0].effect))
    proposal = next_experiment(replace(found, suspects=(first, *found.suspects[1:])), [run], limits=LIMITS)
    assert set(proposal.separates) == set(HIDDEN)
    assert profile.profile_from_text(proposal.profile_yaml).name == proposal.profile_name


def test_a_run_that_says_nothing_of_the_chamber_gets_no_experiment_and_no_error(runs):
    run = runs["thermal_lag"]
    found = replace(diagnose([run], MODEL, candidates=[effects.make("thermal_lag")]), suspects=(), verdict="undecided")
    still = run.with_channel("temperature", np.full(len(run), 25.0))
    assert next_experiment(found, [still]) is None
    assert next_experiment(found, [run]) is not None
    assert next_experiment(replace(found, verdict="adequate"), [run]) is None


def test_a_suspect_that_takes_the_place_of_the_whole_model_leaves_nothing_to_predict_a_run_with():
    suspect = SimpleNamespace(effect="spline", look_alikes=("bias_kink",), model=MODEL)
    answer = SimpleNamespace(leading=None, found=(suspect,), formulas=())
    assert next_experiment(answer, [record("thermal_lag")]) is None


@pytest.mark.parametrize(("least_degc_per_min", "said"), [(0.5, False), (1.8, True), (9.0, False)])
def test_rates_that_the_runs_did_not_show_are_proposed_only_where_they_decide_and_those_do_not(
    monkeypatch, least_degc_per_min, said
):
    class Rated:
        """Any plan that reaches these rates decides."""

        def __init__(self, *_):
            pass

        def expected(self, plan, *, roughly=False):
            decides = plan is not None and max(move.rate_degc_per_min for move in plan.moves) >= least_degc_per_min
            return Expected(np.full(4, 100.0 if decides else 0.0), np.ones(4))

    monkeypatch.setattr(experiment, "Discrimination", Rated)
    monkeypatch.setattr(experiment, "chamber_limits", lambda records: ChamberLimits(-40.0, 85.0, 1.0, 1.0))
    layout = SimpleNamespace(rows=SimpleNamespace(records=()))
    rivals = [Rival(name, effects.make(name), (), 20.0) for name in ("thermal_lag", "hysteresis")]
    found = propose(layout, rivals, (0, 0))
    assert found.decides is (least_degc_per_min < 2.0)
    assert ("it heats with up to 2 and cools with up to 1.5 degC/min, faster than these runs" in found.why) is said
    assert ("rate_degc_per_min: 2" in found.profile_yaml) is said
    assert found.to_json("next.yaml")["faster_degc_per_min"] == ((2.0, 1.5) if said else None)
    own = propose(layout, rivals, (0, 0), ChamberLimits(-40.0, 85.0, 0.4, 0.4))
    assert not own.decides
    assert "faster" not in own.why, "limits that are given are kept to"
