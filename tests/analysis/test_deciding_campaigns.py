"""Campaigns of weak ties, pairs and coverage: what they count, and that a cut campaign still has a section."""

import json

import pytest

from benchmarks import pairs, weak_ties


def test_a_tie_is_decided_only_if_the_hidden_family_alone_is_left(tmp_path):
    case = weak_ties.Case("preisach", 0.7, 1)
    found = {"tied": ["loop", "rate"], "decides": True, "proposed": ["loop"], "minor_loops": ["rate"],
             "again": ["loop", "rate"], "repeated": [], "separable": "proposed"}  # fmt: skip
    beyond = found | {"proposed": ["rate"], "separable": ""}
    assert [weak_ties.decided(case, found, way) for way in weak_ties.WAYS] == [True, False, False, False]
    rows = {row["way"]: row for row in weak_ties.table([(case, found), (case, {"tied": []})])}
    assert (rows["proposed"]["n"], rows["proposed"]["decided"], rows["minor_loops"]["wrong"]) == (1, 1, 1)
    every = weak_ties.table([(case, found), (case, beyond)])
    assert {(row["ties"], row["n"]) for row in every if row["way"] == "proposed"} == {
        ("that some profile decides in each of four runs", 1), ("that a run can tell, by the bench's word", 2),
    }  # fmt: skip
    out = tmp_path / "ties.jsonl"
    assert weak_ties.section(out) == ""
    out.write_text(json.dumps({"hidden": "preisach", "strength": 0.7, "number": 1, "found": found}) + '\n{"hid')
    assert "| the proposed run | 1 | 100 % |" in weak_ties.section(out)


def test_pairs_are_right_where_both_families_and_their_values_are(tmp_path):
    case = pairs.Case("thermal_lag+frost", 1.0, 1)
    found = {"effects": ["frost", "thermal_lag"], "deviations": {"thermal_lag.tau_s": 1.5}}
    assert pairs.right(case, found) == (True, True, True)
    assert pairs.right(case, found | {"deviations": {"thermal_lag.tau_s": -2.5}}) == (True, False, False)
    assert pairs.right(case, found | {"deviations": {"bias_jump.a": 2.5}}) == (True, True, False)
    assert pairs.right(case, found | {"effects": ["frost"]}) == (False, False, False)
    single = pairs.Case("aging", 1.0, 2), {"effects": ["aging"], "deviations": {"aging.line": 1.5}}
    shares = {row["what"]: row["share"] for row in pairs.table([(case, found), single])}
    assert shares == {"both found": 1.0, "places and times": 1.0, "sizes too": 1.0, "within 1": 0.0, "within 2": 1.0}
    assert pairs.section(tmp_path / "none.jsonl") == ""


def test_cases_are_the_same_for_a_seed_and_pairs_are_of_different_effects():
    cases = list(pairs.todo(20, 20, 1))
    assert cases == list(pairs.todo(20, 20, 1))
    assert len(set(cases)) == 40
    names = [case.hidden.split("+") for case in cases if "+" in case.hidden]
    assert all(pairs.HIDDEN[a].effect != pairs.HIDDEN[b].effect for a, b in names)


@pytest.mark.slow
def test_a_single_effect_is_found_with_a_value_that_its_uncertainty_holds():
    case = pairs.Case("thermal_lag", 1.0, 15000)
    found = pairs.run_case(case)
    assert found["effects"][0] == "thermal_lag"
    assert abs(found["deviations"]["thermal_lag.tau_s"]) < 3.0
