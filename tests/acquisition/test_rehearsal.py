"""A rehearsal tells what the run will do."""

import pytest

from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.rehearsal import rehearse
from bench.acquisition.station.settings.chamber import ChamberSettings
from bench.base.errors import InputError
from tests.support import acquisition


def test_it_predicts_the_segments_of_the_run(short_run):
    predicted = rehearse(profile_from_text(acquisition.SHORT), acquisition.station())
    executed = short_run.manifest().segments
    assert [s.name for s in predicted] == [s.name for s in executed]
    for before, after in zip(predicted, executed, strict=True):
        assert before.to_s - before.from_s == pytest.approx(after.to_s - after.from_s, abs=30)


def test_a_guard_that_could_never_trip_is_refused_before_anything_is_opened():
    text = "name: p\nguards: [{name: shut, signal: door, above: 0.5}]\nsegments: [{kind: soak, duration_min: 1}]\n"
    with pytest.raises(InputError, match="guard 'shut' watches door, which nothing of this station tells"):
        rehearse(profile_from_text(text), acquisition.station())


def test_it_says_which_segment_would_time_out():
    text = "name: p\nsegments:\n  - {kind: ramp, to_degc: -40, rate_degc_per_min: 20, timeout_min: 1}\n"
    ramp, _ = rehearse(profile_from_text(text), acquisition.station())
    assert ramp.outcome == "timeout"
    assert "chamber air is" in ramp.reason


def test_the_chamber_of_the_station_file_is_rehearsed():
    settings = acquisition.station()
    text = "name: p\nsegments:\n  - {kind: ramp, to_degc: -40, rate_degc_per_min: 5}\n"
    weak = {"net_cooling_w": [[-45, 0], [23, 100]]}
    slow = settings.model_copy(
        update={"chamber": ChamberSettings.model_validate({**settings.chamber.model_dump(), "simulation": weak})}
    )
    assert rehearse(profile_from_text(text), slow)[0].to_s > 1.5 * rehearse(profile_from_text(text), settings)[0].to_s
