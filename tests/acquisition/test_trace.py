"""The trace of a live run: bounded for a day, and no sample of it forgotten."""

import json
import math
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.acquisition.recording.trace import CAPACITY, Envelope, Trace

NAN = math.nan
NONE = (NAN, NAN, 0.0, 0)
"""No valid sample."""
DAY_S = 86_400


def whole(trace):
    """All points of a trace, page by page."""
    page = trace.since()
    points = page["points"]
    while page["next"] < page["count"]:
        page = trace.since(page["next"], page["generation"])
        points += page["points"]
    return points


def run(trace, ticks, span=lambda tick: (-1.0, 1.0), unit="G-1"):
    for tick in range(ticks):
        low, high = span(tick)
        trace.add(float(tick), (20.0, 21.0), [(unit, 22.0, NONE if math.isnan(low) else (low, high, low + high, 2))])


def test_a_point_is_a_tick_as_long_as_there_is_room():
    trace = Trace()
    trace.add(1.0, (25.0, 24.5), [("G-1", 24.0, (-3.0, 4.0, 3.0, 6)), ("G-2", NAN, NONE)])
    page = trace.since()
    assert page["serials"] == ["G-1", "G-2"]
    assert page["points"] == [[1.0, 25.0, 24.5, [24.0, None], [[-3.0, 4.0, 0.5], [None, None, None]]]]
    assert (page["first"], page["next"], page["count"], page["every_s"]) == (0, 1, 1, 1.0)


@pytest.mark.parametrize("at", [0, 1, 12_345, 50_000, DAY_S - 1])
def test_a_spike_of_one_sample_is_still_there_after_a_day(at):
    trace, samples = Trace(), np.zeros(500)
    envelope = Envelope()
    for tick in range(DAY_S):
        samples[tick % 500] = 1e4 if tick == at else 0.0
        envelope.add(samples)
        samples[tick % 500] = 0.0
        trace.add(float(tick), (20.0, 21.0), [("G-1", 22.0, envelope.take())])
    points = whole(trace)
    newest = trace.since(trace.since()["count"])["open"]
    assert len(points) <= CAPACITY
    spikes = [point for point in [*points, *([newest] if newest else [])] if point[4][0][1] == 1e4]
    assert len(spikes) == 1
    assert at <= spikes[0][0] < at + trace.since()["every_s"]


def test_memory_and_answers_are_bounded_however_long_the_run_is():
    trace = Trace(capacity=64)
    run(trace, 10_000)
    assert trace._rows.shape == (64, 8)
    assert 32 <= trace.since()["count"] < 64
    many = Trace()
    for tick in range(CAPACITY - 1):
        many.add(
            tick * 1.0,
            (-40.125, -40.125),
            [(f"G-{n}", -39.875, (-12345.678, 12345.678, -2469.1356, 2)) for n in range(32)],
        )
    assert len(json.dumps(many.since())) < 50_000
    assert len(whole(many)) == CAPACITY - 1


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(0, 1e6)) | st.none(), min_size=1, max_size=300))
def test_every_rate_is_inside_the_point_of_its_time(spans):
    trace = Trace(capacity=16)
    spans = [(NAN, NAN) if span is None else (span[0], span[0] + span[1]) for span in spans]
    run(trace, len(spans), lambda tick: spans[tick])
    last = trace.since(trace.since()["count"])["open"]
    points, since = [*whole(trace), *([last] if last else [])], 0
    assert points[-1][0] == len(spans) - 1
    for t_s, *_, ((low, high, mean),) in points:
        within = np.array(spans[since : int(t_s) + 1])
        since = int(t_s) + 1
        if np.isnan(within).all():
            assert (low, high, mean) == (None, None, None)
        else:
            assert (low, high) == (
                pytest.approx(np.nanmin(within), abs=6e-4),
                pytest.approx(np.nanmax(within), abs=6e-4),
            )
            assert mean == pytest.approx(np.nanmean(within), abs=6e-4, rel=1e-9)


def test_who_asks_for_what_is_new_gets_that_and_after_a_halving_everything():
    trace = Trace(capacity=8)
    run(trace, 5)
    known = trace.since()
    run(trace, 2)
    news = trace.since(known["next"], known["generation"])
    assert (news["first"], len(news["points"])) == (5, 2)
    run(trace, 1)  # full: halved
    anew = trace.since(news["next"], news["generation"])
    assert anew["generation"] != news["generation"]
    assert (anew["first"], anew["count"], anew["every_s"]) == (0, 4, 2.0)


@pytest.mark.parametrize(("index", "generation"), [(-1, None), (99, None), (2, 5)])
def test_an_index_that_is_none_begins_at_the_beginning(index, generation):
    trace = Trace()
    run(trace, 5)
    assert trace.since(index, generation)["first"] == 0


def test_traces_of_two_processes_are_told_apart():
    first, second = Trace(capacity=4, origin=1_000_000), Trace(capacity=4, origin=1_000_001)
    run(first, 100)
    assert first.since()["generation"] < second.since()["generation"] < 2**53


def test_a_unit_that_left_keeps_its_place_and_says_nothing():
    trace = Trace()
    trace.add(0.0, (20.0, 20.0), [("G-1", 1.0, (1.0, 1.0, 1.0, 1)), ("G-2", 2.0, (2.0, 2.0, 2.0, 1))])
    trace.add(1.0, (20.0, 20.0), [("G-2", 3.0, (3.0, 3.0, 3.0, 1))])
    assert whole(trace)[1][3:] == [[None, 3.0], [[None, None, None], [3.0, 3.0, 3.0]]]


def test_the_open_point_tells_what_is_not_complete_yet():
    trace = Trace(capacity=4)
    run(trace, 4)
    trace.add(4.0, (20.0, 21.0), [("G-1", 22.0, (-7.0, 7.0, 4.0, 8))])
    page = trace.since(2)
    assert (page["points"], page["open"]) == ([], [4.0, 20.0, 21.0, [22.0], [[-7.0, 7.0, 0.5]]])


def test_an_envelope_has_every_sample_since_it_was_taken_and_no_invalid_one():
    envelope = Envelope()
    envelope.add(np.array([1.0, NAN, -5.0]))
    envelope.add(np.array([]))
    envelope.add(np.array([NAN]))
    envelope.add(np.array([2.0, 0.0]))
    assert envelope.take() == (-5.0, 2.0, -2.0, 4)
    low, high, total, count = envelope.take()
    assert np.isnan([low, high]).all()
    assert (total, count) == (0.0, 0)


def test_a_mean_has_each_sample_once_however_many_a_tick_had():
    trace = Trace(capacity=4)
    for tick, (total, count) in enumerate([(10.0, 1), (0.0, 0), (0.0, 4), (35.0, 5)]):  # the fourth fills the trace
        trace.add(float(tick), (20.0, 21.0), [("G-1", 22.0, (0.0, 10.0, total, count) if count else NONE)])
    assert [point[4][0][2] for point in whole(trace)] == [10.0, pytest.approx(35.0 / 9.0, abs=1e-3)]


def test_reading_while_the_run_adds_never_tears_a_point():
    trace, done = Trace(capacity=16), threading.Event()

    def add():
        for tick in range(20_000):
            trace.add(
                float(tick),
                (float(tick), float(tick)),
                [("G-1", float(tick), (float(tick), float(tick), float(tick), 1))],
            )
        done.set()

    thread = threading.Thread(target=add)
    thread.start()
    while not done.is_set():
        for t_s, setpoint, chamber, (degc,), ((_, high, _mean),) in trace.since()["points"]:
            assert t_s == setpoint == chamber == degc == high
    thread.join()
