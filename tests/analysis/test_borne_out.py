"""What a report says at its head: only what unseen data bear out; and numbers that can be read."""

from types import SimpleNamespace

import numpy as np

from bench.analysis.judging.diagnosed import Diagnosed, Rung
from bench.analysis.judging.verdict import RunVerdict, with_diagnosis
from bench.base import ends, with_uncertainty

FOUND = SimpleNamespace(effect="resonance_frequency", look_alikes=())
OWN = RunVerdict("adequate", "Complete, no frame lost; spline leaves 1.1 × the noise floor on unseen data.")


def headline(before, after, verdict, named=(), model="spline"):
    answer = SimpleNamespace(verdict=verdict, found=(FOUND,), named=named, model=SimpleNamespace(name=model))
    rungs = (
        Rung("spline", 1.0, before),
        Rung("+ resonance_frequency", 0.9, after),
        Rung("rival", np.nan, 0.1, rival=True),
    )
    return with_diagnosis(OWN, Diagnosed(answer, rungs), 0.1)


def test_an_effect_that_makes_unseen_data_worse_is_no_headline():
    found = headline(0.2, 0.3, "undecided")
    assert (found.word, found.headline) == ("undecided", "Not decided")
    assert not found.missing
    assert "unseen data do not bear out: the error there goes from 0.200 to 0.300 deg/h" in found.sentence


def test_an_effect_that_no_unseen_data_could_judge_has_no_error_there():
    assert headline(0.2, np.nan, "undecided").sentence.endswith(
        "spline may lack resonance_frequency, which no unseen data could judge."
    )


def test_an_effect_that_unseen_data_prove_is_named():
    assert headline(0.2, 0.1, "missing_effect", (FOUND,)).headline == "Missing: resonance_frequency"


def test_effects_that_the_data_cannot_tell_apart_are_named_together():
    alike = ("quadrature_leakage", "k * play(temperature, 5)", "k * lag(dT_dt, 60)")
    tied = SimpleNamespace(effect="resonance_frequency", look_alikes=alike)
    said = headline(0.2, 0.1, "missing_effect", (tied,))
    assert said.headline == "Missing: resonance_frequency or quadrature_leakage or a formula"
    assert "lacks resonance_frequency or quadrature_leakage or a formula; adding it would" in said.sentence


def test_where_another_model_was_diagnosed_than_the_best_both_say_what_they_leave():
    assert "; spline lacks resonance" in headline(0.11, 0.1, "missing_effect", (FOUND,)).sentence
    other = headline(0.2, 0.1, "missing_effect", (FOUND,), "curve").sentence
    text = "leaves 2.0 × in its diagnosis and lacks resonance_frequency; adding it would leave 1.0 ×."
    assert other.endswith(f"data; curve {text}")


def test_where_the_diagnosis_begins_is_told_where_it_is_not_the_error_of_the_comparison():
    found = headline(0.2, 0.1, "missing_effect", (FOUND,)).sentence
    assert "spline leaves 1.1 × the noise floor on unseen data; spline leaves 2.0 × in its diagnosis and" in found


def test_ends_of_a_range_are_told_apart():
    assert ends(13999.62, 14000.31, 5) == ("13999.62", "14000.31")
    assert ends(-39.9, 85.2) == ("-39.9", "85.2")
    assert ends(5.0, 5.0) == ("5.00", "5.00")


def test_zero_by_constraint_says_so():
    assert with_uncertainty(0.0, 0.0) == ("0 (by constraint)", "–")
