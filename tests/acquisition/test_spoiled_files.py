"""Mutated files are read or refused: a seeded sample of the whole campaign, `python -m benchmarks.spoiled_files`."""

import json
from dataclasses import asdict, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.acquisition.importer.tables import read_table
from bench.base import InputError, parse_yaml
from benchmarks.campaigns import read
from benchmarks.mutations import BINARY, NUMBERS, TEXT, TOKENS
from benchmarks.spoiled_files import GOOD, MOST_BYTES, Case, Outcome, campaign, cases, content, run_case

SEED, EACH = 14, 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", GOOD)
def test_spoiled_files_are_read_or_refused(kind):
    for number in range(EACH):
        outcome = run_case(Case(kind, number), SEED)
        wrong = "" if outcome.wrong == "over 10 s" else outcome.wrong  # time is for the campaign to judge
        assert wrong == "", outcome


@pytest.mark.slow
@pytest.mark.parametrize("kind", GOOD)
def test_the_good_files_are_read(kind, monkeypatch):
    monkeypatch.setattr("benchmarks.spoiled_files.mutated", lambda data, source, mutations: data)
    outcome = run_case(Case(kind, 0), SEED)
    assert (outcome.code, outcome.wrong) == (0, ""), outcome


def test_the_campaign_is_the_same_for_the_same_seed_and_covers_every_kind():
    assert {case.kind for case in cases(3000)} == set(GOOD)
    assert len(set(cases(3000))) == 3000
    for kind in ("csv", "profile"):
        found = [content(Case(kind, number), SEED) for number in range(40)]
        assert found == [content(Case(kind, number), SEED) for number in range(40)]
        assert len(set(found)) > 30
        assert found[0] != content(Case(kind, 0), SEED + 1)


def test_an_interrupted_campaign_goes_on_where_it_was(tmp_path):
    path = tmp_path / "spoiled.jsonl"
    done = Outcome(Case("csv", 0), 2, "a line", 0.5, 10**8)
    path.write_text(json.dumps(asdict(done)) + '\n{"case": {"ki')
    assert campaign([done.case], SEED, path) == [done]
    assert len(read(path, dict)) == 1


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"code": -1}, "traceback"),
        ({"said": "Traceback (most recent call last)"}, "traceback"),
        ({"code": -2}, "over 10 s"),
        ({"cpu_s": 10.5}, "over 10 s"),
        ({"peak_bytes": MOST_BYTES + 1}, "over 1 GB"),
        ({"code": 4}, "exit code 4"),
        ({"said": "a\n" * 50}, "more than one line"),
        ({}, ""),
    ],
)
def test_what_would_be_wrong_is_told(changes, wrong):
    assert replace(Outcome(Case("csv", 0), 2, "a line", 0.5, 10**8), **changes).wrong == wrong


WORDS = st.lists(st.sampled_from([*TOKENS, *NUMBERS, "name", "kind", " ", "\n", "\n  "]), max_size=30).map("".join)
SOME = settings(max_examples=200, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


@SOME
@given(WORDS)
def test_any_words_of_yaml_are_read_or_refused(text):
    refusal = ""
    try:
        parse_yaml(text, "a.yaml")
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal


@SOME
@given(st.randoms(use_true_random=False), st.integers(1, 4))
def test_any_table_is_read_or_refused(tmp_path_factory, source, count):
    data = b"time,rate,temperature\n0,1.5,25\n1,2.5,26\n2,1.25,27\n"
    for _ in range(count):
        data = source.choice(TEXT + BINARY)(data, source)
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(data)
    refusal = ""
    try:
        assert read_table(path).rows > 0
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal
