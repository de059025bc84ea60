"""What a report says at its head: only what unseen data bear out; and numbers that can be read."""

from types import SimpleNamespace

import numpy as np

from bench.analysis.diagnosis.proof import Proof
from bench.analysis.judging.diagnosed import Diagnosed, Rung
from bench.analysis.judging.verdict import RunVerdict, with_diagnosis
from bench.base import ends, with_uncertainty

PROOF = Proof("legs", 0.3, 0.15, 9.0)
FOUND = SimpleNamespace(effect="resonance_frequency", look_alikes=(), proof=PROOF)
OWN = RunVerdict("adequate", "Complete, no frame lost; spline leaves 1.1 × the noise floor on unseen data.")


def headline(before, after, verdict, named=(), model="spline"):
    answer = SimpleNamespace(
        verdict=verdict, found=(FOUND,), named=named, model=SimpleNamespace(name=model), resolution=""
    )
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
    tied = SimpleNamespace(effect="resonance_frequency", look_alikes=alike, proof=PROOF)
    said = headline(0.2, 0.1, "missing_effect", (tied,))
    assert said.headline == "Missing: resonance_frequency or quadrature_leakage or a formula"
    assert "lacks resonance_frequency or quadrature_leakage or a formula; adding it lowers" in said.sentence


def test_what_adding_the_missing_effect_gains_is_what_proves_it():
    found = headline(0.2, 0.1, "missing_effect", (FOUND,), "curve").sentence
    text = "lacks resonance_frequency; adding it lowers the error on legs left out from 0.300 to 0.150 deg/h."
    assert found.endswith(f"1.1 × the noise floor on unseen data; curve {text}")


def test_of_several_missing_effects_each_is_proved_beside_the_others():
    other = SimpleNamespace(effect="aging", look_alikes=(), proof=PROOF)
    assert headline(0.2, 0.1, "missing_effect", (FOUND, other)).sentence.endswith(
        "lacks resonance_frequency and aging."
    )


def test_ends_of_a_range_are_told_apart():
    assert ends(13999.62, 14000.31, 5) == ("13999.62", "14000.31")
    assert ends(-39.9, 85.2) == ("-39.9", "85.2")
    assert ends(5.0, 5.0) == ("5.00", "5.00")


def test_zero_by_constraint_says_so():
    assert with_uncertainty(0.0, 0.0) == ("0 (by constraint)", "–")
