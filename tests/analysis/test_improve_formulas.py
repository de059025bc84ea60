"""The walk goes on where the catalogue ends: a formula is added only where it lowers the error on unseen data."""

from types import SimpleNamespace

import pytest

from bench.analysis.diagnosis.improve import _with_formula, improve
from bench.analysis.diagnosis.proof import Proof
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


@pytest.mark.parametrize(("check", "deviations", "action"), [
    ((), 4.0, "refused"), ((), 9.0, "added"), (("two",), 4.0, "added"),
])  # fmt: skip
def test_without_check_runs_a_formula_is_added_only_where_the_run_proves_it(check, deviations, action):
    doubt = "" if deviations > 5.0 else "the best of many formulas may do that by chance"
    proof = Proof("legs", 0.3, 0.2, deviations, doubt=doubt)
    formula = SimpleNamespace(held_out_before_dph=0.3, held_out_rms_dph=0.2, formula="k * time", weighed="evidence 20",
                              beside=(), model="more", proof=proof)  # fmt: skip
    step = _with_formula(SimpleNamespace(check=check, model="own", floor_dph=0.1), formula)
    assert (step.action, step.model) == (action, "more" if action == "added" else "own")
    assert ("by chance" in step.sentence) is (action == "refused")
