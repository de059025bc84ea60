"""Only the answers of the chamber are spoiled, its requests still arrive: a seeded sample of the whole campaign.

The whole is `python -m benchmarks.spoiled_answers`.
"""

import json
from dataclasses import asdict

import pytest

from benchmarks.spoiled_answers import Case, Outcome, campaign, cases, read, run_case
from benchmarks.spoiling import KINDS
from drivers.registers import list_maps

SEED, N = 14, 8
SAMPLE = cases(SEED)[:N]


@pytest.mark.parametrize("case", SAMPLE, ids=lambda case: f"{case.map}-{case.function}-{case.kind}-{case.when}")
@pytest.mark.slow
def test_the_chamber_is_off_and_what_is_not_verified_is_said(case, tmp_path):
    outcome = run_case(case, SEED, tmp_path)
    assert outcome.wrong == "", outcome


@pytest.mark.parametrize("kind", ["exception 4", "one byte a second"])
@pytest.mark.slow
def test_reads_that_are_spoiled_in_a_ramp_end_the_run_with_the_chamber_off(kind, tmp_path):
    outcome = run_case(Case("watlow_f4t", 3, kind, "ramp"), SEED, tmp_path)
    assert outcome.struck_at_end > 0
    assert (outcome.off, outcome.setpoint, outcome.unverified) == (True, 23.0, True)
    assert outcome.said.count("switch the chamber off by hand") == 1


def test_the_campaign_covers_every_map_function_and_kind_at_each_time():
    everything = cases(SEED)
    assert {case.map for case in everything} == set(list_maps())
    assert {case.kind for case in everything} == set(KINDS)
    assert {case.function for case in everything} == {3, 4, 6, 16} & {case.function for case in everything}
    assert len(everything) == len(set(everything)) >= 3 * 30 * 2 * len(list_maps())
    assert cases(SEED) == everything


def test_an_interrupted_campaign_goes_on_where_it_was(tmp_path):
    path = tmp_path / "spoiled.jsonl"
    done = Outcome(SAMPLE[0], True, 23.0, 5, 5, "SAFE STATE NOT VERIFIED")
    path.write_text(json.dumps(asdict(done)) + '\n{"case": {"ma')
    assert read(path) == [done]
    assert campaign(SAMPLE[:1], SEED, path) == [done]


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"off": False}, "the chamber is on"),
        ({"said": "", "struck_at_end": 0, "setpoint": 24.5}, "its set point is 24.5 degC"),
        ({"said": ""}, "claims to be verified"),
        ({}, ""),
    ],
)
def test_what_would_be_wrong_is_told(changes, wrong):
    fields = {"off": True, "setpoint": 23.0, "struck": 9, "struck_at_end": 3, "said": "SAFE STATE NOT VERIFIED: x"}
    found = Outcome(case=Case("watlow_f4t", 3, "nothing", "ramp"), **fields | changes).wrong
    assert wrong in found
    assert bool(found) == bool(wrong)
