"""A seeded sample of benchmarks/turn_on_coverage.py."""

import pytest

from benchmarks import turn_on_coverage


@pytest.mark.slow
def test_the_stated_uncertainty_holds_fresh_turn_ons(tmp_path):
    todo = list(turn_on_coverage.cases(4, ("shipped",), ("spline",)))
    results = turn_on_coverage.campaign(todo, 1, tmp_path / "coverage.jsonl")
    for row in turn_on_coverage.table(results):
        assert row["held"] == row["n"] >= 3, row
        assert not row["below"]
    errors = [found["mean_error_dph"] for _, found in results]
    assert errors[0] != errors[1]
    again = turn_on_coverage.campaign(todo, 1, tmp_path / "coverage.jsonl")
    assert [found for _, found in again] == [found for _, found in results]


def test_a_share_that_is_certainly_too_small_is_below_the_bar():
    case = turn_on_coverage.Case("shipped", 0)
    found = {"expanded_dph": 1.0, "outside": 0.1, "error_dph": 0.5, "mean_error_dph": 0.5}
    wide = [(case, found | {"error_dph": 2.0 * (i < 12)}) for i in range(100)]
    rows = {row["what"]: row for row in turn_on_coverage.table(wide)}
    assert (rows["error_dph"]["held"], rows["error_dph"]["below"]) == (88, True)
    assert (rows["mean_error_dph"]["held"], rows["mean_error_dph"]["below"]) == (100, False)
