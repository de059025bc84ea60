"""Short versions of the soak run and of the kills: the benchmarks themselves, and what they must show."""

from __future__ import annotations

import json

import pytest

from benchmarks.kills import MOST_LOST_S, kill_often
from benchmarks.soak import random_faults, soak


@pytest.mark.slow(first=True)
def test_an_hour_of_random_faults_leaves_every_sample_accounted_for_and_no_handle(tmp_path):
    figures = soak(0.75, 3, tmp_path, mean_s=150.0, every_s=60.0)
    assert figures["wrong"] == [], json.dumps(figures)
    assert figures["faults"] > 10
    assert figures["handles_before_after"][0] == figures["handles_before_after"][1]


def test_faults_repeat_with_their_seed():
    assert random_faults(24, 1, 600) == random_faults(24, 1, 600) != random_faults(24, 2, 600)
    assert 100 < len(random_faults(24, 1, 600)) < 200


@pytest.mark.slow
def test_a_killed_bench_loses_less_than_a_second_and_leaves_a_safe_chamber(tmp_path):
    (kill,) = kill_often(1, 7, tmp_path)
    assert kill.lost_s <= MOST_LOST_S
    assert kill.safe
    assert kill.gaps == 0
