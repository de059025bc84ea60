"""Wrong data from the unit or the chamber's sensor: a seeded sample of the whole campaign, and two units on one number.

The whole is `python -m benchmarks.spoiled_unit_data`.
"""

from __future__ import annotations

import functools
import json
from dataclasses import asdict

import numpy as np
import pytest

import bench.acquisition.station.stage as opening
from bench.acquisition.run.runner import run_job
from benchmarks.spoiled_unit_data import AT_S, KINDS, LENGTHS_S, Case, Outcome, campaign, cases, read, run_case
from tests.support import acquisition

SEED, N = 14, 5


@pytest.mark.slow
@pytest.mark.parametrize("case", cases(SEED)[:N], ids=lambda case: f"{case.kind}-{case.length_s:g}")
def test_what_is_no_measurement_is_left_out_and_the_record_is_not_admissible(case, tmp_path):
    outcome = run_case(case, SEED, tmp_path)
    assert outcome.wrong == "", outcome


def test_the_campaign_has_twenty_kinds_and_two_lengths():
    everything = cases(SEED)
    assert len(KINDS) >= 20
    assert len(everything) == len(set(everything)) == len(KINDS) * len(LENGTHS_S)
    assert cases(SEED) == everything


def test_an_interrupted_campaign_goes_on_where_it_was(tmp_path):
    path = tmp_path / "spoiled.jsonl"
    case = cases(SEED)[0]
    done = Outcome(case, "done", 6.0, 6.0, False, False, False, True, "At its end")
    path.write_text(json.dumps(asdict(done)) + '\n{"case": {"ki')
    assert read(path) == [done]
    assert campaign([case], SEED, path) == [done]


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"complete": True, "admissible": True}, "complete and admissible"),
        ({"within": True}, "complete and admissible"),
        ({"left_out_s": 7.5}, "7.50 s are left out"),
        ({"same_again": False}, "another record"),
        ({}, ""),
    ],
)
def test_what_would_be_wrong_is_told(changes, wrong):
    fields = {"spoiled_s": 6.0, "left_out_s": 6.5, "complete": False, "admissible": True, "within": False}
    fields |= {"same_again": True, "sentence": "x"}
    found = Outcome(case=Case("rate 0", 6.0), state="done", **fields | changes).wrong
    assert wrong in found
    assert bool(found) == bool(wrong)


class Twin:
    """The unit's bus with a second unit on it that says it is the same: same identifiers, same serial number."""

    def __init__(self, bus, ahead):
        self.bus, self.ahead = bus, ahead

    def __getattr__(self, name):
        return getattr(self.bus, name)

    def send_block(self, frames):
        if len(frames) and frames["t_ns"][0] * 1e-9 >= AT_S:
            from benchmarks.spoiled_unit_data import RATE, _number, _signed

            other = frames.copy()
            rows = np.flatnonzero(other["id"] == RATE)
            data = other["data"][rows]
            _number(0, "<i4", lambda raw: raw + 24_000)(data)
            _number(4, "<u2", lambda raw: raw + self.ahead)(data)
            other["data"][rows] = _signed(data, RATE)
            other["t_ns"] += 900_000
            frames = np.concatenate((frames, other))
            frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        self.bus.send_block(frames)


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [0, 3, 20_000])
def test_a_second_unit_with_the_same_serial_number_ends_the_run(ahead, tmp_path, monkeypatch):
    simulate = opening.simulate

    @functools.wraps(simulate)
    def doubled(*args, **options):
        world = simulate(*args, **options)
        for unit in world.units:
            unit.wire.bus = Twin(unit.wire.bus, ahead)
        return world

    monkeypatch.setattr(opening, "simulate", doubled)
    result = run_job(acquisition.job(tmp_path, acquisition.LONG))
    assert result.error.exit_code == 4
    assert "two units with this number on one bus; disconnect one" in str(result.error)
    manifest = result.run.manifest()
    assert manifest.state == "failed"
    assert manifest.duration_s < AT_S + 20.0
    assert [entry.why for entry in manifest.left_out] == ["two units on one number"]
