"""The walk goes on where the catalogue ends: a formula is added only where it lowers the error on unseen data."""

import pytest

from bench.analysis.diagnosis.improve import improve
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import load_model
from benchmarks import outside

FEW = [effects.make(name) for name in ("thermal_lag", "temperature_rate")]


@pytest.mark.slow
@pytest.mark.parametrize("formulas", [True, False])
def test_what_no_effect_describes_is_added_as_a_formula_that_lowers_the_error_unless_none_is_wanted(formulas, tmp_path):
    (first, check, _, still), _ = outside._unit(outside.Trial("duffing", 3.0, 1))
    found = improve([first], [check], outside.MODEL, static=still, candidates=FEW, formulas=formulas)
    before, after = (outside._rms(outside._left(m, first, check)) for m in (outside.MODEL, found.model))
    if not formulas:
        assert all(effect.name != "expression" for effect in found.model.effects)
        return
    added = next(step for step in found.to_json()["steps"] if step["action"] == "added")
    assert (added["effect"], "drive" in added["formula"]) == ("expression", True)
    assert after < 0.4 * before
    written = tmp_path / "better.yaml"
    written.write_text(found.model.to_yaml())
    assert load_model(written) == found.model
