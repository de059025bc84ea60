"""A rehearsal tells what the run will do."""

import acquisition
import pytest

from bench.profile import from_text
from bench.rehearsal import rehearse


def test_it_predicts_the_segments_of_the_run(short_run):
    predicted = rehearse(from_text(acquisition.SHORT), acquisition.station())
    executed = short_run.manifest()["segments"]
    assert [s.name for s in predicted] == [s["name"] for s in executed]
    for before, after in zip(predicted, executed, strict=True):
        assert before.to_s - before.from_s == pytest.approx(after["to_s"] - after["from_s"], abs=30)


def test_it_says_which_segment_would_time_out():
    text = "name: p\nsegments:\n  - {kind: ramp, to_degc: -40, rate_degc_per_min: 20, timeout_min: 1}\n"
    ramp, _ = rehearse(from_text(text), acquisition.station())
    assert ramp.outcome == "timeout"
    assert "chamber air is" in ramp.reason
