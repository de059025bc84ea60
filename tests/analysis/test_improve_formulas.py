"""The walk goes on where the catalogue ends: a formula is added only where it lowers the error on unseen data."""

import pytest

from bench.analysis.diagnosis.improve import improve
from bench.analysis.effects.model import load_model
from benchmarks import outside


@pytest.mark.slow
def test_a_mechanism_that_no_effect_describes_is_added_as_a_formula_and_the_error_falls_to_the_true_models(tmp_path):
    (first, check, still), truth = outside._unit(outside.Trial("brown_out", 3.0, 1))
    found = improve([first], [check], outside.MODEL, static=still)
    added = next(step for step in found.to_json()["steps"] if step["action"] == "added")
    assert added["effect"] == "expression"
    assert "supply" in added["formula"]
    oracle = outside._rms(outside._oracle(first, check, truth))
    assert outside._rms(outside._left(found.model, first, check)) < 1.35 * oracle
    written = tmp_path / "better.yaml"
    written.write_text(found.model.to_yaml())
    assert load_model(written) == found.model


def test_without_formulas_the_walk_stays_within_the_catalogue():
    (first, check, still), _ = outside._unit(outside.Trial("brown_out", 3.0, 1))
    found = improve([first], [check], outside.MODEL, static=still, formulas=False)
    assert all(effect.name != "expression" for effect in found.model.effects)
