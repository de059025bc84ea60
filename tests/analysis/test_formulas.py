"""Formulas for what the catalogue does not hold: found on truths that share no operator with them, none on noise."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from bench.analysis.diagnosis.blocks import Block, Formula
from bench.analysis.diagnosis.describing import Describer, _judged
from bench.analysis.diagnosis.diagnose import _Case, diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.diagnosis.formulas import FormulaSearch
from bench.analysis.diagnosis.found_formula import FoundFormula
from bench.analysis.diagnosis.grammar import Grammar
from bench.analysis.diagnosis.held_out import Unseen
from bench.analysis.diagnosis.memories import memories
from bench.analysis.diagnosis.physics import physics_of
from bench.analysis.diagnosis.proof import LeftOut
from bench.analysis.diagnosis.states import states
from bench.analysis.effects import registry as effects
from bench.analysis.effects.expression import Expression
from bench.analysis.effects.model import Model, effect_from, entry_text, load_model
from bench.analysis.fit.fitting import fit_model
from bench.analysis.noise.likelihood import NoiseLattice
from bench.analysis.thresholds import FORMULA_EVIDENCE
from bench.base import InputError
from bench.base.language import told
from bench.cli import main
from benchmarks import cases, outside
from benchmarks.mechanisms.textbooks import surface_above_mean
from benchmarks.trials import MODEL


@pytest.fixture(scope="module")
def quiet():
    """A unit without any hidden mechanism: its run, and its isothermal run."""
    case = cases.case((), 0.0, 3, outside.RUN, MODEL)
    return case.quiet(outside.RUN, 0), case.quiet(cases.STATIC, 4)


@pytest.mark.parametrize("best", [(10, -40), (-40, -40), (-64, 3), (-48, -48)])
def test_less_noise_than_the_lattice_has_is_none(best):
    """Between the least and none nothing is next to a point: a search of the noise from there ended in an error."""
    points = FormulaSearch._points(SimpleNamespace(_best=best))
    assert all(point in NoiseLattice.around(point, step) for point in points for step in (8, 1))


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["beat", "draught"])
def test_a_formula_predicts_an_unseen_run_of_a_unit_that_no_effect_of_the_catalogue_describes(truth):
    found = outside.run_trial(outside.Trial(truth, 3.0, 1))
    assert found["formula"]
    assert found["share"] > outside.LEAST_SHARE, found
    assert found["ratio"] < outside.MOST_RATIO, found


@pytest.mark.slow
def test_products_that_make_up_for_a_coarse_grid_do_not_hide_the_plain_formula():
    found = outside.run_trial(outside.Trial("crossed_modes", 3.0, 1))
    away = r"\(\(frequency - [\d.]+\)/[\d.]+\)"
    assert re.fullmatch(rf"k \* {away}/\(1 \+ {away}\*\*2\)", found["formula"]), found
    assert (found["verdict"], found["proved"]) == ("unknown_effect", True), found  # effects that it replaces were not
    assert found["ratio"] < outside.MOST_RATIO, found


@pytest.mark.slow
def test_what_depends_on_the_temperature_of_a_part_inside_is_told_by_a_place_in_one_that_lags():
    """Rubber that is stiff in the cold: little is seen of it at a place in a temperature that does not lag."""
    found = outside.run_trial(outside.Trial("softened_mount", 1.0, 1))
    assert re.search(r"\(1 - tanh\(\(lag\(temperature, (2[5-9]|3[0-4])\d(\.\d)?\)", found["formula"]), found
    assert found["share"] > 0.9, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "formula"),
    [
        ("mode_late", r"k \* lag\(1/\(1 \+ \(\(frequency - 14000\.\d\)/0\.\d+\)\*\*2\), [56]\d\d(\.\d+)?\)"),
        ("switch_that_heats", r"k \* lag\((latch\(temperature, .*\)|tanh\(\(temperature - .*\)), 1[0-4]\d\d(\.\d+)?\)"),
    ],
)
def test_what_begins_somewhere_and_lasts_is_found(truth, formula):
    """Little of it is seen at once, or at places and time constants that are not refined."""
    found = outside.run_trial(outside.Trial(truth, 1.0, 1))
    assert re.fullmatch(formula, found["formula"]), found
    assert found["share"] > outside.LEAST_SHARE, found


@pytest.mark.slow
def test_an_effect_that_leaves_no_more_than_the_noise_does_not_hide_a_formula_that_explains_more():
    """A gradient that saturates looks like a loop in the run and in the check run; in steps it does not."""
    (run, check, _, still), _ = outside._unit(outside.Trial("saturating_gradient", 1.0, 1))
    answer = diagnose([run], MODEL, check=[check], static=still)
    best = answer.formulas[0]
    assert re.match(r"k \* tanh\(lag\(dT_dt, ", best.formula), best.formula
    assert (answer.verdict, [suspect.effect for suspect in answer.found]) == ("unknown_effect", ["hysteresis"])
    # Runs and check run do not tell dT/dt from the gap to the air, which another run tells from it.
    proposal = next_experiment(answer, [run], check=[check], static=still)
    assert proposal.separates[0] == best.formula
    assert set(proposal.separates[1:]) <= set(best.equivalent)
    assert (proposal.use, proposal.decides) == ("run", True)
    assert proposal.probability_before < proposal.probability_after


@pytest.mark.slow
def test_a_formula_that_explains_more_than_an_effect_is_told_beside_it_and_a_run_decides(monkeypatch):
    monkeypatch.setitem(outside.TRUTHS, "slab", lambda world, _: surface_above_mean(world.case, 1060.0))
    (run, check, _, still), _ = outside._unit(outside.Trial("slab", 1.0, 1))
    answer = diagnose([run], MODEL, check=[check], static=still)
    (found,), best = answer.found, answer.formulas[0]
    assert (answer.verdict, found.effect) == ("missing_effect", "hysteresis")
    assert re.match(r"k \* lag\(dT_dt, ", best.formula), best.formula
    assert best.formula in found.look_alikes
    assert found.effect in best.equivalent
    assert f"or {best.formula}" in answer.sentence
    assert answer.added == found.added  # not the formula, which is not ahead by what a formula needs
    proposal = next_experiment(answer, [run], check=[check], static=still)
    assert {found.effect, best.formula} <= set(proposal.separates)
    assert proposal.probability_before < proposal.probability_after


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "number"),
    [
        (("thermal_lag", "temperature_rate"), 210064),
        (("thermal_network", "temperature_rate"), 300043),
        (("supply_voltage", "compressor"), 300022),
    ],
)
def test_two_effects_that_hide_each_other_are_named_together(hidden, number):
    """A thermal lag undoes most of dT/dt over the curve of the first two units, of which the second one had an effect
    in a part of the range; nothing was missing from the third, whose compressor pulls its supply.
    """
    unit = cases.case(hidden, 1.0, number, outside.RUN, MODEL)
    answer = diagnose([unit.run(outside.RUN)], MODEL, static=unit.quiet(cases.STATIC, 4))
    assert (answer.verdict, answer.proved) == ("missing_effect", True)
    families = {"thermal_network": "thermal_lag"}
    assert {suspect.effect for suspect in answer.found} == {families.get(name, name) for name in hidden}


@pytest.mark.slow
def test_what_the_run_alone_cannot_tell_from_its_noise_is_found_where_the_check_run_bears_it():
    (run, check, _, still), _ = outside._unit(outside.Trial("stress_that_relaxes", 1.0, 1))
    assert diagnose([run], MODEL, static=still).formulas == ()
    answer = diagnose([run], MODEL, check=[check], static=still)
    best = answer.formulas[0]
    assert answer.verdict == "unknown_effect"
    assert best.evidence < FORMULA_EVIDENCE < best.evidence + best.borne
    assert best.proof.proved


@pytest.mark.slow
def test_a_slow_effect_that_the_run_alone_cannot_tell_is_named_where_the_check_run_bears_it():
    unit = cases.case(("aging",), 0.8, 3, outside.RUN, MODEL)
    run, check, still = unit.run(outside.RUN), unit.run(outside.CHECK), unit.quiet(cases.STATIC, 4)
    assert diagnose([run], MODEL, static=still).found == ()
    answer = diagnose([run], MODEL, check=[check], static=still)
    assert (answer.verdict, [suspect.effect for suspect in answer.found]) == ("missing_effect", ["aging"])


@pytest.mark.slow
@pytest.mark.parametrize(("slow", "other", "number"), [("aging", "thermal_lag", 10_003), ("creep", "frost", 210_029)])
def test_a_slow_effect_is_named_beside_another_one(slow, other, number):
    unit = cases.case(tuple(sorted((slow, other))), 1.0, number, cases.TWO_RATES, MODEL)
    answer = diagnose([unit.run(cases.TWO_RATES)], MODEL, static=unit.quiet(cases.STATIC, 4))
    assert [suspect.effect for suspect in answer.found] == [other, slow]


@pytest.mark.slow
def test_a_quantity_of_a_table_that_no_channel_is_explains_a_run(quiet):
    run, still = quiet
    check = cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)

    def shaken(record, mean):
        """A pump that runs for 600 of 1700 s shakes the unit, which follows within 300 s."""
        pump = mean + (np.mod(record.time, 1700.0) < 600.0)
        follows = np.empty(len(pump))
        level = pump[0]
        for row, value in enumerate(pump):
            level += (1.0 - np.exp(-record.interval_s / 300.0)) * (value - level)
            follows[row] = level
        return replace(
            record, channels={**record.channels, "other_1": pump, "rate": record.channels["rate"] + 0.8 * follows}
        )

    answer = diagnose([shaken(run, 0.0)], MODEL, check=[shaken(check, 0.5)], static=still)
    best = answer.formulas[0]
    assert re.match(r"k \* lag\(\(other_1 - .*\), (2[5-9]\d|3[0-4]\d)\.?\d*\)", best.formula), best.formula
    assert best.proof.proved
    assert answer.sentence.startswith("The model lacks something that no effect of the catalogue explains")
    first, second = answer.sentence.index("A formula that fits"), answer.sentence.find("nearest")
    assert second == -1 or first < second
    constant = [note for note in answer.notes if "is a constant of the check run" in note]
    assert len(constant) == 1
    assert answer.held_out_rms_dph > 1.2 * best.proof.before_dph


def trapped(case):
    """Charge that is taken up within a minute where it gets warmer, and given off within 90 minutes."""
    held, out = case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        held += (value - held) / (60.0 if value > held else 5400.0)
        out[second] = held
    return 0.03 * (out - case)


def passed_on(case):
    """Heat that passes from the case to a frame and on to a block: a force while the flow changes."""
    frame = block = case[0]
    out = np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        flow = (value - frame) / 90.0
        frame += flow
        out[second] = flow - (frame - block) / 90.0
        block += (frame - block) / 90.0
    return 90.0 * out


def stiffened(case):
    """A glue passes a gradient on, e times as much for every 30 degC that it is colder."""
    return 0.2 * 60.0 * np.gradient(case) * np.exp(-(case - 25.0) / 30.0)


def loosened(case):
    """Above 30 degC a joint gives way to gradients, the more the warmer it is."""
    return 0.02 * np.maximum(case - 30.0, 0.0) * 60.0 * np.gradient(case)


def softened(case):
    """What creeps above 35 degC, and back below, within 33 minutes."""
    out, state = np.empty(len(case)), max(case[0] - 35.0, 0.0)
    for second, value in enumerate(case.tolist()):
        state += (max(value - 35.0, 0.0) - state) / 2000.0
        out[second] = 0.06 * state
    return out


def turned(case):
    """Friction that turns about within 7 minutes of each turn of the temperature."""
    moved, out = 0.0, np.empty(len(case))
    for second, rate in enumerate(np.gradient(case) * 60.0):
        moved += ((0.0 if abs(rate) < 0.1 else np.copysign(1.0, rate)) - moved) / 400.0
        out[second] = 0.4 * moved
    return out


def opposed(case):
    """A part that follows the temperature within 6 minutes, against one that does within 50."""
    fast = slow = case[0]
    out = np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        fast, slow = fast + (value - fast) / 380.0, slow + (value - slow) / 3000.0
        out[second] = 0.04 * (value - fast - 0.45 * (value - slow))
    return out


def strained(case):
    """A stiff cover that follows within 9 minutes, whose strain grows by the cube of its gap to the case."""
    inside, out = case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        inside += (value - inside) / 550.0
        out[second] = 0.004 * (value - inside) ** 3
    return out


def soaked_through(case):
    """A part within a thick wall, whose face follows the case; its far end is 2.5 h away."""
    wall, out = np.full(150, case[0]), np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        wall[1:-1] += 0.4 * np.diff(wall, 2)
        wall[0], wall[-1] = value, wall[-2]
        out[second] = 0.03 * (value - wall[25])
    return out


def activated(case):
    """A strain that grows by e for every 5 degC that a part inside is behind."""
    inside, out = case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        inside += (value - inside) / 480.0
        out[second] = 0.15 * np.exp((value - inside) / 5.0)
    return out


def yielded(case):
    """A joint that gives way above 40 degC, where it was never before."""
    return 0.05 * np.maximum(np.maximum.accumulate(case) - 40.0, 0.0)


def wandering(case):
    """Interference over the temperature, whose path grows by 1.2 degC an hour."""
    return 0.5 * np.sin(2.0 * np.pi * (case + 1.2 * np.arange(len(case)) / 3600.0) / 13.0)


def clocked(case):
    """A heater that a clock switches on for 400 s of every 1100 s while a part that lags is below 15 degC."""
    inside, out = case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        inside += (value - inside) / 300.0
        out[second] = 0.6 * ((second + 250) % 1100 < 400) / (1.0 + np.exp((inside - 15.0) / 4.0))
    return out


def thawing(case):
    """A spring that slides at a force which falls by e for every 40 degC."""
    spring, last, out = 0.0, case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        force = 9.0 * np.exp((25.0 - value) / 40.0)
        spring, last = min(max(spring + value - last, -force), force), value
        out[second] = 0.06 * spring
    return out


def resting(case):
    """What settles within 15 minutes wherever the temperature stays, and goes as slowly where it changes."""
    state, out = 1.0, np.empty(len(case))
    for second, rate in enumerate(np.gradient(case) * 60.0):
        state += ((1.0 if abs(rate) < 0.1 else 0.0) - state) / 900.0
        out[second] = 0.6 * state
    return out


def annealed(case):
    """Stress that cooling adds, and that is gone within an hour at 25 degC, within minutes when it is hot."""
    stress, last, out = 0.0, case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        stress += max(last - value, 0.0) - stress / 3600.0 * np.exp(0.04 * (value - 25.0))
        out[second], last = 0.03 * stress, value
    return out


def cracked(case):
    """A crack that springs open at 0 degC, and closes steadily until 14 degC."""
    is_open, out = False, np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        is_open = value < (14.0 if is_open else 0.0)
        out[second] = 0.03 * (14.0 - value) if is_open else 0.0
    return out


def worn(case):
    """A contact that warming wears, that cooling cleans at half the speed, and that forgets within 50 minutes."""
    level, last, out = 0.0, case[0], np.empty(len(case))
    for second, value in enumerate(case.tolist()):
        level += max(value - last, 0.0) - 0.5 * max(last - value, 0.0) - level / 3000.0
        out[second], last = 0.04 * level, value
    return out


def transformed(case):
    """Grains that change their phase about 20 degC, each 5 degC later up than at the middle, and as much later down."""
    at = np.linspace(-1.5, 1.5, 61)
    at, changed, out = 20.0 + 12.0 * at, at < 0.0, np.empty(len(case))
    for second, value in enumerate(case):
        changed = np.where(changed, value > at - 5.0, value > at + 5.0)
        out[second] = 2.0 * changed.mean()
    return out


def with_hidden(record, hidden):
    """The run with what a mechanism makes of its temperature, second by second."""
    seconds = np.arange(record.time[0], record.time[-1] + 1.0)
    added = np.interp(record.time, seconds, hidden(np.interp(seconds, record.time, record.channel("temperature"))))
    return replace(record, channels={**record.channels, "rate": record.channels["rate"] + added})


def diagnosed(quiet, hidden, candidates=None):
    """The diagnosis of the unit with a mechanism, with a check run."""
    (run, still), check = quiet, cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)
    runs = (with_hidden(run, hidden), with_hidden(check, hidden))
    return diagnose(runs[:1], MODEL, check=runs[1:], static=still, candidates=candidates)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "formula"),
    [
        (stiffened, r"k \* dT_dt \* exp\(-0\.03[0-6]\d* \* \(temperature - 25\)\)"),
        (loosened, r"k \* dT_dt \* above\(temperature - (2[89]|3[0-2])(\.\d*)?\)"),
        (softened, r"k \* lag\(above\(temperature - 3\d(\.\d*)?\), (1[6-9]|2[0-4])\d\d(\.\d*)?\)"),
        (trapped, r"k \* \(temperature - uneven_lag\(temperature, \d+(\.\d+)?, [56]\d\d\d(\.\d+)?\)\)"),
        (turned, r"k \* lag\(direction, (3[0-9]|4[0-4])\d(\.\d+)?\)"),
        (
            opposed,
            r"k \* \(\(temperature - lag\(temperature, .*\)\) - 0\.\d+ \* \(temperature - lag\(temperature, .*\)\)\)",
        ),
        (strained, r"k \* sign\(lag\(dT_dt, 5[2-8]\d(\.\d+)?\)\) \* abs\(lag\(dT_dt, .*\)\)\*\*(2\.9|3\.[01])\d*"),
        (activated, r"k \* exp\(0\.(19|20|21)\d* \* \(temperature - lag\(temperature, 4[678]\d(\.\d+)?\)\)\)"),
        (yielded, r"k \* above\(highest\(temperature\) - (39|40)(\.\d+)?\)"),
        (resting, r"k \* lag\(\(1 \+ tanh\(\(abs\(dT_dt\) - 0\.(0[89]|1[01])\d*\)/0\.05\)\), [89]\d\d(\.\d+)?\)"),
        (annealed, r"k \* lag\(above\(-dT_dt\) \* exp\(0\.0[34]\d* \* \(25 - temperature\)\), \d+.*"),
        (cracked, r"k \* \(1 - latch\(temperature, (.*)\)\) \* \(.* - temperature\)"),
        (worn, r"k \* lag\(\(dT_dt \+ 0\.(29|3\d)\d* \* abs\(dT_dt\)\), (2[5-9]|3[0-4])\d\d(\.\d+)?\)"),
        (
            wandering,
            r"k \* sin\(2\*pi\*\(temperature \+ 1\.(1[89]|2[012]?)\d* \* time/3600\)/(12\.9\d*|13(\.0\d*)?)\) \+ .*",
        ),
        (
            thawing,
            r"k \* \(temperature - play\(temperature, (8\.[89]|9(\.[0-2])?)\d* \* exp\(0\.02[3-7]\d* \* \(25 - temp.*",
        ),
        (
            clocked,
            r"k \* \(1 \+ tanh\(\(sin\(2\*pi\*\(time - .*\)/(1099|1100)(\.\d+)?\) .*\)/0\.15\)\) \* \(1 - tanh\(\(.*",
        ),
        (passed_on, r"k \* \(dT_dt - lag\(dT_dt, \d+(\.\d+)?\)\)"),
    ],
)
def test_what_a_mechanism_does_is_found_as_the_formula_that_it_is(quiet, hidden, formula):
    few = [effects.make(name) for name in ("bias_jump", "creep")]  # the catalogue takes as long as the formulas
    best = diagnosed(quiet, hidden, few).formulas[0]
    assert re.fullmatch(formula, best.formula), best.formula
    assert best.proof.proved


@pytest.mark.slow
def test_heat_that_spreads_into_a_wall_is_told_from_nothing_but_the_memory_of_the_air(quiet):
    best = diagnosed(quiet, soaked_through).formulas[0]
    assert any("lag(temperature, 25 * " in text for text in (best.formula, *best.equivalent)), best
    assert best.proof.proved


@pytest.mark.slow
def test_one_formula_takes_the_place_of_several_effects_that_nothing_proves(quiet):
    """A loop over a part of the range was two suspects, one of them a fault of the thermometer."""
    answer = diagnosed(quiet, transformed)
    # A play between two temperatures is the same to these data.
    formula = r"k \* (play\(tanh\(\(temperature - (1[6-9]|2[0-4])|\(temperature - play\(temperature, [4-6]).*"
    assert re.fullmatch(formula, answer.formulas[0].formula), answer.formulas[0].formula
    assert answer.verdict == "unknown_effect"


@pytest.mark.slow
def test_the_gap_of_two_thermometers_of_a_unit_takes_the_place_of_several_effects(quiet):
    """A second thermometer is nearer to the air; the catalogue knows only what the first one feels."""
    run, still = quiet
    check = cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)

    def with_case(record):
        own = record.channel("temperature")
        case = own + np.interp(record.time, record.time + 120.0, 4.0 * record.dT_dt)  # degC/min for a few minutes
        rate = record.channels["rate"] + 0.12 * (case - own)
        return replace(record, channels={**record.channels, "temperature_2": case, "rate": rate})

    answer = diagnose([with_case(run)], MODEL, check=[with_case(check)], static=still)
    assert answer.formulas, answer.sentence
    assert answer.formulas[0].formula == "k * (temperature_2 - temperature)"
    assert answer.formulas[0].amplitudes[0][1] == pytest.approx(0.12, abs=0.01)


@pytest.mark.slow
def test_a_name_does_not_hide_a_formula_where_the_soaks_have_a_part_of_what_is_missing(quiet):
    """The floor that is read from them is then far above what the name leaves, and proves nothing."""
    run, _ = quiet
    check = cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)

    def switched(record):
        on = (np.mod(record.time, 660.0) < 300.0).astype(float)
        place = np.exp(-(((record.channel("temperature") - 30.0) / 30.0) ** 2))
        rate = record.channels["rate"] + 0.5 * on * place
        return replace(record, channels={**record.channels, "compressor": on, "rate": rate})

    answer = diagnose([switched(run)], MODEL, check=[switched(check)])
    assert answer.formulas, answer.sentence
    assert answer.formulas[0].proof.proved
    assert "compressor" in answer.formulas[0].formula
    assert answer.formulas[0].held_out_rms_dph < 0.9 * answer.found[0].held_out_rms_dph


@pytest.mark.slow
def test_a_part_that_snaps_over_at_two_temperatures_is_found_where_its_jumps_are(quiet):
    """In quiet data no place of a grid is near enough to a sharp jump for it to be seen."""
    run, still = quiet
    check = cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)

    def snapped(record):
        state, states = 1.0, []
        for degc in record.channel("temperature"):
            state = 1.0 if degc > 21.7 else 0.0 if degc < 6.3 else state
            states.append(state)
        rate = record.channels["rate"] + 0.8 * np.array(states)
        return replace(record, channels={**record.channels, "rate": rate})

    answer = diagnose([snapped(run)], MODEL, check=[snapped(check)], static=still)
    assert answer.formulas, answer.sentence
    assert answer.formulas[0].formula.startswith("k * latch(temperature, ")
    centre, width = map(float, re.findall(r"([\d.]+) \+ ([\d.]+)", answer.formulas[0].formula)[0])
    assert [centre, width] == pytest.approx([14.0, 7.7], abs=0.6)
    assert answer.formulas[0].held_out_rms_dph < 1.15 * answer.floor_dph


@pytest.mark.slow
def test_terms_of_one_formula_have_the_sizes_that_they_have_together(quiet):
    """Found one after the other, the first had taken in a part of the next."""

    def both(case):
        return 2.0 * thawing(case) + resting(case)

    run = with_hidden(quiet[0], both)
    best = diagnosed(quiet, both, [effects.make(name) for name in ("bias_jump", "creep")]).formulas[0]
    model = replace(best.model, effects=(*best.model.effects[:-1], Expression(best.formula)))
    fit = fit_model(model, [run], weights="noise")
    fitted = {one.key.removeprefix("expression."): one.value for one in fit.coefficients}
    assert len(best.amplitudes) > 1
    for name, value, std, _ in best.amplitudes:
        assert abs(value - fitted[name]) < 3.0 * std, name  # the noise, and the effects beside it, are fitted anew
        assert abs(value) > 2.0 * std, name


@pytest.mark.slow
def test_a_product_of_many_factors_does_not_take_the_place_of_an_effect():
    """Each factor more is one of many that were tried, which the formula pays for."""
    frost = cases.case(("frost",), 3.0, 1, outside.RUN, MODEL)
    answer = diagnose([frost.run(outside.RUN)], MODEL, static=frost.quiet(cases.STATIC, 4))
    assert (answer.verdict, answer.proved) == ("missing_effect", True), answer.sentence
    assert [suspect.effect for suspect in answer.found] == ["frost"]


@pytest.mark.slow
def test_what_a_channel_does_while_the_unit_is_heated_alone_is_told_from_what_it_does_at_rest(quiet):
    def with_it(record):
        slope = np.gradient(record.channel("temperature"), record.time) * 60.0
        added = 12.0 * (record.channel("quadrature") - 0.02) * (slope > 0.05)
        return replace(record, channels={**record.channels, "rate": record.channels["rate"] + added})

    run, still = quiet
    check = cases.case((), 0.0, 3, outside.RUN, MODEL).quiet(outside.CHECK, 1)
    best = diagnose([with_it(run)], MODEL, check=[with_it(check)], static=still).formulas[0]
    assert re.search(r"above\(direction\)", best.formula), best.formula
    assert "(1 + direction)" not in best.formula
    assert best.proof.proved


@pytest.mark.parametrize(
    ("text", "theta", "open_"),
    [
        ("lag(tanh((temperature - {centre})/{width}), {tau_s})", (50.0, 0.5, 20.0), ()),
        ("lag(tanh((temperature - {centre})/{width}), {tau_s})", (50.0, 3.0, 2000.0), ("tau_s",)),
        ("exp(-((temperature - {centre})/{width})**2)", (50.0, 0.5), ("width",)),
        ("tanh(dT_dt/{limit})", (0.1,), ()),
    ],
)
def test_what_is_as_sharp_or_as_fast_as_is_searched_is_determined(text, theta, open_):
    """A step or a lag within a row is none; a window of one row and a lag of the whole run are not determined."""
    names = re.findall(r"\{(\w+)\}", text)
    ends = {"centre": (0.0, 100.0), "width": (0.5, 50.0), "tau_s": (20.0, 2000.0), "limit": (0.1, 10.0)}
    block = Block(text, "what is tried", "", tuple((name, ends[name]) for name in names))
    found = FoundFormula(Formula((block,)), theta, 20.0, (0, 0), *[np.zeros(1)] * 5)
    assert found.undetermined == open_


def test_the_formula_that_a_check_run_proves_against_another_comes_first():
    rng = np.random.default_rng(1)

    def ranked(total, borne, error_dph):
        left = LeftOut("check", error_dph * rng.normal(size=2000), np.ones(2000))
        one = SimpleNamespace(formula=SimpleNamespace(within=lambda _: False), evidence=total - borne)
        return SimpleNamespace(total=total, borne=borne, scored=Unseen(error_dph, left=left), one=one)

    more, less, alike = ranked(352.0, 76.0, 0.7), ranked(304.0, 135.0, 0.27), ranked(300.0, 136.0, 0.27)
    assert _judged([more, less, alike]) == [less, more, alike]
    assert _judged([less, more]) == [less, more]
    less.borne = 77.0  # no more probable with it
    assert _judged([more, less])[0] is more
    less.borne, less.one.evidence = 100.0, 100.0  # the fitted run speaks by far more against it
    assert _judged([more, less])[0] is more
    assert _judged([]) == []


@pytest.mark.slow
def test_what_is_found_is_added_as_it_is_written(quiet, tmp_path):
    run, still = quiet
    wave = 0.4 * np.sin(2.0 * np.pi * run.channel("temperature") / 9.3 + 1.0)
    waved = replace(run, channels={**run.channels, "rate": run.channels["rate"] + wave})
    answer = diagnose([waved], MODEL, static=still)
    best = answer.to_json()["formulas"][0]
    assert answer.verdict == "unknown_effect"
    assert best["proved"]
    assert answer.noise_finding == ""  # the run drifts more only without the formula
    proposal = next_experiment(answer, [waved], static=still)
    assert proposal is None if not best["equivalent"] else proposal.separates[0] == best["formula"]
    assert "like an etalon" in answer.sentence
    assert best["held_out_rms_dph"] < 0.6 * best["held_out_before_dph"]
    out = tmp_path / "better.yaml"
    done = CliRunner().invoke(main, ["add", "aging", best["expression"], "--model", "spline", "--out", str(out)])
    assert done.exit_code == 0, done.output
    _, aging, added = load_model(out).effects
    assert (aging.name, added.name) == ("aging", "expression")
    assert {p.name: p.low < 9.3 < p.high for p in added.parameters} == {"period_degc": True}


@pytest.mark.slow
def test_what_follows_a_channel_of_an_instrument_is_found(quiet):
    run, still = quiet
    humidity = 30.0 + 8.0 * np.sin(run.time / 2300.0 + 0.4) + 4.0 * np.sin(run.time / 700.0)
    moist = {**run.channels, "humidity": humidity, "rate": run.channels["rate"] + 0.05 * (humidity - 30.0)}
    answer = diagnose([replace(run, channels=moist)], MODEL, static=still)
    assert answer.verdict == "unknown_effect"
    assert "a misfit over humidity" in answer.sentence
    assert "k * (humidity - 29.5" in answer.to_json()["formulas"][0]["expression"]


@pytest.mark.slow
def test_a_formula_that_writes_an_effect_found_in_a_shorter_way_does_not_take_its_place(quiet):
    run, still = quiet
    led = {**run.channels, "rate": run.channels["rate"] + 0.3 * run.dT_dt}
    case = _Case.of((replace(run, channels=led),), MODEL, still, [effects.make("temperature_rate")], None)
    describer = Describer(case.lattice, (), case.floor_dph)
    named, other = (case.layout.adding(effects.make(name), ()) for name in ("temperature_rate", "supply_voltage"))
    found = describer._search(case.layout, (0, 0))
    slope = next(one for one in found if one.text == "k * dT_dt")
    assert (describer._says_more(slope, named), describer._says_more(slope, other)) == (False, True)


@pytest.mark.slow
def test_a_sine_over_temperature_that_turns_with_its_rate_of_change_is_found(quiet):
    """Heating and cooling alike leave nothing of the sine alone."""
    run, still = quiet
    wave = 0.3 * np.sin(2.0 * np.pi * run.channel("temperature") / 13.0) * run.dT_dt
    waved = replace(run, channels={**run.channels, "rate": run.channels["rate"] + wave})
    case = _Case.of((waved,), MODEL, still, [effects.make("temperature_rate")], None)
    found = Describer(case.lattice, (), case.floor_dph)._search(case.layout, (0, 0))
    assert re.match(r"k \* sin\(2\*pi\*temperature/1[23]\.\d+\) \* dT_dt", found[0].text), found[0].text


@pytest.mark.slow
def test_a_line_that_comes_with_the_chambers_heater_is_found_with_it():
    """It stood for heating times whatever channel is large in the cold, and the check run was predicted badly."""
    unit = cases.case(("emi",), 1.0, 902, outside.RUN, MODEL)
    run, check, still = unit.run(outside.RUN), unit.run(outside.CHECK, 1), unit.quiet(cases.STATIC, 4)
    answer = diagnose([run], MODEL, check=[check], static=still)
    best = answer.formulas[0]
    heater = r"above\(chamber_temperature - lag\(chamber_temperature, 60\) \+ .*\)"
    assert re.match(rf"k \* sin\(2\*pi\*time/60[67]\.\d\) \* {heater} \+ k_cos", best.formula), best.formula
    assert "interference of the chamber's heater" in best.like
    assert best.proof.after_dph < 1.15 * answer.floor_dph < best.proof.before_dph


@pytest.mark.slow
def test_noise_gives_no_formula(quiet):
    run, still = quiet
    answer = diagnose([run], MODEL, static=still)
    assert (answer.formulas, answer.to_json()["formulas"]) == ((), [])


class Integrated:
    """What follows the second-by-second temperature of a unit and of its air, one step at a time."""

    def __init__(self, case, air):
        self.glue = self.behind = self.follows = self.oven = self.rested = case
        self.dragged, self.hottest, self.stress, self.lost = air - case, case, 0.0, 0.0
        self.rising, self.kicked, self.is_open, self.last = False, 0.0, False, case

    def step(self, case, air):
        """All values after a second."""
        change, self.last = case - self.last, case
        self.glue += (case - self.glue) / 900.0 * np.exp(0.03 * (case - 25.0))
        self.behind += np.clip(case - self.behind, -0.8 / 60.0, 0.8 / 60.0)
        self.dragged = np.clip(self.dragged, air - case - 3.0, air - case + 3.0)
        self.follows += (case - self.follows) / 300.0
        self.hottest = max(self.hottest + (25.0 - self.hottest) / 20_000.0, case)
        self.stress += max(-change, 0.0) - self.stress / 900.0 * np.exp(0.03 * (case - 25.0))
        self.lost += max(-change, 0.0) * (case < 10.0)
        self.oven += (case + np.clip(40.0 - case, -18.0, 18.0) - self.oven) / 400.0
        self.rested += (case - self.rested) / (300.0 if abs(change) < 0.05 / 60.0 else 1500.0)
        turned = self.rising != (change > 0.0) and abs(change) > 0.1 / 60.0
        self.rising ^= turned
        self.kicked += turned * (1.0 if self.rising else -1.0) - self.kicked / 1800.0
        self.is_open = case < (14.0 if self.is_open else 0.0)
        return (
            case - self.glue, case - self.behind, self.dragged,
            np.copysign(max(abs(case - self.follows) - 1.5, 0.0), case - self.follows), self.hottest,
            (case - 3.0) % 14.0, self.stress, self.lost, self.oven, case - self.rested, self.kicked,
            (14.0 - case) * self.is_open,
        )  # fmt: skip


STATES = (
    ("(temperature - lag(temperature, {tau_s} * exp", {"tau_s": 900.0, "faster": 0.03}),
    ("(temperature - slew(", {"per_min": 0.8}),
    ("play((chamber", {"width": 3.0}),
    ("dead_zone(lag(dT_dt", {"tau_s": 300.0, "zone": 1.5 / 5.0}),
    ("exp(-time/{tau_s}) * highest", {"tau_s": 20_000.0}),
    ("sawtooth((temperature", {"at": 3.0, "step": 14.0}),
    ("lag(above(-dT_dt) * exp({faster}", {"faster": 0.03, "tau_s": 900.0}),
    ("total(above(-dT_dt)", {"centre": 10.0}),
    ("lag(dead_zone(temperature", {"centre": 40.0, "width": 18.0, "tau_s": 400.0}),
    ("(temperature - lag(temperature, {tau_s} * (1 + {slower}", {"tau_s": 300.0, "slower": 4.0}),
    ("lag(latch(lag(dT_dt", {"fast_s": 20.0, "tau_s": 1800.0}),
    ("(1 - latch(temperature", {"centre": 7.0, "width": 7.0}),
)


def test_blocks_with_a_state_are_what_an_integration_gives(quiet):
    run, _ = quiet
    seconds = np.arange(run.time[0], run.time[-1])
    case, air = (np.interp(seconds, run.time, run.channels[n]) for n in ("temperature", "chamber_temperature"))
    unit = Integrated(float(case[0]), float(air[0]))
    truths = np.array([unit.step(*now) for now in zip(case.tolist(), air.tolist(), strict=True)]).T
    grammar = Grammar([run], [np.isfinite(run.bias)])
    driver = next(block for block in grammar.drivers() if block.text == "lag(dT_dt, {tau_s})")
    blocks = [*states(grammar.ranges), *memories(grammar.ranges), *driver.variants(run.time[-1])]
    for (start, values), truth in zip(STATES, truths, strict=True):
        block = next(block for block in blocks if block.text.startswith(start))
        effect = Expression("k * " + block.text.format(**{name: name for name in values}), dict(block.bounds))
        column = effect.columns(run, values)[:, 0]
        least = 0.85 if "latch(lag(" in start else 0.99  # dT/dt, whose sign tells a turn, is read over minutes
        assert np.corrcoef(column, np.interp(run.time, seconds, truth))[0, 1] > least, start


def test_what_a_formula_is_has_words_in_every_language(quiet):
    run, _ = quiet
    grammar = Grammar([run], [np.isfinite(run.bias)])
    blocks = [block for one in (*grammar.singles(), *grammar.pairs()) for block in one.blocks]
    ways = [way for one in grammar.singles() for way, _ in one.one_way(one.grid()[0])]
    blocks += [block for way in ways for block in way.blocks]
    said = {made.words for block in blocks for made in (block, *block.variants(20_000.0, grammar.ranges.switched))}
    assert len(said) > 200
    left = {words: re.sub("dT/dt", "", told(words, "uk") or words) for words in said - {"dT/dt", "|dT/dt|"}}
    assert [words for words, text in left.items() if re.search("[a-z]{3}", text)] == []


def test_what_the_chambers_heater_and_cooling_give_is_seen_in_its_air(quiet):
    """The air is warmed by a heater that is on and off, cooled by a valve, and loses heat to a room at 21 degC."""
    run, _ = quiet
    seconds = np.arange(run.time[0], run.time[-1])
    heater, valve = (np.sin(seconds / 700.0) > 0.3).astype(float), np.maximum(-np.sin(seconds / 700.0) - 0.2, 0.0)
    air = np.full(len(seconds), 21.0)
    for i, (heats, cools) in enumerate(zip(heater[1:], valve[1:], strict=True), start=1):
        air[i] = air[i - 1] + (3.0 * heats - 2.5 * cools) / 60.0 - (air[i - 1] - 21.0) / 1500.0
    run = run.with_channel("chamber_temperature", np.interp(run.time, seconds, air))
    drivers = Grammar([run], [np.isfinite(run.bias)]).drivers()
    for start, power in (("above(chamber", heater), ("above(lag(chamber", valve)):
        block = next(block for block in drivers if block.text.startswith(start))
        effect = Expression("k * " + block.text.format(loss="loss", room="room"), dict(block.bounds))
        column = effect.columns(run, {"loss": 60.0 / 1500.0, "room": 21.0})[:, 0]
        assert np.corrcoef(column, np.interp(run.time, seconds, power))[0, 1] > 0.97, start


def test_every_formula_of_the_grammar_is_one_that_a_model_file_may_hold(quiet):
    run, _ = quiet
    grammar = Grammar([run], [np.isfinite(run.bias)])
    formulas = [*grammar.singles(), *grammar.pairs(), grammar.line([600.0, 900.0])]
    assert len(formulas) > 300
    began = [*grammar.singles(), grammar.line([600.0, 900.0])]
    grown = [one for formula in began for one in grammar.grown(formula, formula.grid()[0])]
    assert {"lag(dT_dt, tau_s * exp(faster * (25 - temperature)))", "delay(dT_dt, late_s)"} <= {
        formula.product(formula.names) for formula, _ in grown
    }
    tried = [(formula, theta[0]) for formula, theta in grown[:: len(grown) // 300]]
    for formula, theta in [*((formula, formula.grid()[0]) for formula in formulas), *tried]:
        assert formula.expression().parameters == formula.parameters  # values go by this order
        effect = effect_from(entry_text(formula.near(theta)))
        assert effect == formula.near(theta)
        assert [p.low < value < p.high for p, value in zip(effect.parameters, theta, strict=True)] == [True] * len(
            theta
        )


def test_what_is_neither_a_name_nor_a_formula_is_refused_in_one_line(tmp_path):
    for wrong in ("thermal_lagg", "k * nothing(", "{expression: {formula: 1}}", "{a: 1, b: 2}", "{expression: [", ""):
        with pytest.raises(InputError) as refused:
            effect_from(wrong)
        assert "\n" not in str(refused.value)


def test_two_formulas_may_stand_in_one_model_but_not_the_same_twice():
    from bench.analysis.diagnosis.improve import add_effect

    one = add_effect(Model("m", (Expression("k * dT_dt**2"),)), "k * quadrature")
    assert [effect.name for effect in one.effects] == ["expression", "expression"]
    with pytest.raises(InputError, match="already"):
        add_effect(one, "k * quadrature")


@pytest.mark.parametrize(("period_degc", "blocks", "said"), [
    (9.0, 1, "like an etalon"), (50.0, 1, "more intervals of its spline may do the same"), (50.0, 2, ""),
])  # fmt: skip
def test_a_sine_over_much_of_the_range_is_a_bend_of_the_curve_and_no_etalon(period_degc, blocks, said):
    layout = SimpleNamespace(temperature=np.array([-40.0, 85.0]))
    text, formula = f"k * sin(2*pi*temperature/{period_degc})", SimpleNamespace(blocks=("sine", "dT_dt")[:blocks])
    words = physics_of(layout, SimpleNamespace(text=text, theta=(period_degc,), formula=formula))
    assert said in words
    assert bool(said) is bool(words)
