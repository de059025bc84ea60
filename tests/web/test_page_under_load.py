"""An abort during a real-time run while others hold the page: a sample of `python -m benchmarks.page_under_load`."""

from dataclasses import replace

import pytest

from benchmarks.page_under_load import LOADS, Case, Outcome, cases, run_case

SAMPLE = [Case("idle", "page", 300), Case("slow bodies", "socket", 300)]


@pytest.mark.slow
@pytest.mark.parametrize("case", SAMPLE, ids=lambda case: f"{case.load}-{case.via}")
def test_the_abort_is_heard_and_no_frame_is_lost(case, tmp_path):
    outcome = run_case(case, tmp_path)
    assert (outcome.state, outcome.lost) == ("aborted", 0), outcome
    assert outcome.opened >= case.connections
    assert outcome.frames > 0


def test_the_campaign_covers_every_load_and_both_ways():
    assert {(case.load, case.via) for case in cases(2000)} == {
        (load, via) for load in LOADS for via in ("page", "socket")
    }


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"state": "done"}, "the run is done"),
        ({"lost": 3}, "3 of 900 frames lost"),
        ({"frames": 0}, "0 of 0 frames lost"),
        ({"abort_s": 1.5}, "the abort took 1.50 s"),
        ({}, ""),
    ],
)
def test_what_would_be_wrong_is_told(changes, wrong):
    fine = Outcome(SAMPLE[0], 64, 300, 0.2, 0.01, 0.1, "aborted", 900, 0)
    assert replace(fine, **changes).wrong == wrong
