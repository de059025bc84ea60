"""Mean residual of each turn-on and their scatter, against sums made by hand."""

import statistics

import numpy as np
import pytest

from bench.analysis import turn_ons
from bench.base import InputError
from bench.record import Dataset, Segment


def record(name, segments, **channels):
    """Rows of 1 s; `segments` are (kind, turn-on, rows)."""
    index = np.concatenate([np.full(rows, i) for i, (_, _, rows) in enumerate(segments)])
    time = np.arange(len(index), dtype=float)
    parts = tuple(Segment(i, f"s{i}", kind, turn_on=number) for i, (kind, number, _) in enumerate(segments))
    columns = {"rate": np.zeros(len(index)), "temperature": np.zeros(len(index)), **channels}
    return Dataset(name, time, columns, index.astype(np.int64), parts)


def test_runs_and_power_cycles_are_turn_ons_of_their_own():
    one = record("a", [("soak", 1, 4), ("soak", 2, 2)])
    two = record("b", [("soak", 1, 3)])
    found = turn_ons([one, two], [np.array([1.0, 1.0, 3.0, 3.0, -1.0, -2.0]), np.full(3, 5.0)])
    assert [(t.run, t.number, t.mean_dph, t.seconds) for t in found.each] == [
        ("a", 1, 2.0, 4.0),
        ("a", 2, -1.5, 2.0),
        ("b", 1, 5.0, 3.0),
    ]
    assert found.between_dph == pytest.approx(statistics.stdev([2.0, -1.5, 5.0]))
    assert found.degrees_of_freedom == 2


def test_gaps_and_turning_do_not_count_and_rows_between_segments_belong_to_the_turn_on_before():
    applied = np.array([0.0, 0.0, 50.0, 0.0, 0.0])
    data = record("a", [("soak", 1, 5)], applied_rate=applied)
    found = turn_ons([data], [np.array([1.0, np.nan, 100.0, 3.0, 2.0])])
    assert found.each[0].mean_dph == pytest.approx(2.0)
    assert (found.between_dph, found.degrees_of_freedom) == (None, 0)
    between = record("b", [("soak", 1, 2), ("soak", 2, 2)])
    loose = Dataset("b", between.time, between.channels, np.array([0, -1, 1, -1]), between.segments)
    assert loose.turn_on.tolist() == [1, 1, 2, 2]


def test_the_scatter_is_that_of_the_truth():
    """Chi square of 400 simulated sets of 5 turn-ons: the mean of the variances is the truth."""
    random = np.random.default_rng(7)
    variances = []
    for _ in range(400):
        draws = random.normal(0.0, 0.3, 5)
        data = [record(str(i), [("soak", 1, 50)]) for i in range(5)]
        found = turn_ons(data, [draw + random.normal(0.0, 0.01, 50) for draw in draws])
        variances.append(found.between_dph**2)
    assert np.mean(variances) == pytest.approx(0.09, rel=3 * np.sqrt(2 / (4 * 400)))


def test_residuals_of_another_record_are_refused():
    with pytest.raises(InputError, match="3 residuals for 5 rows"):
        turn_ons([record("a", [("soak", 1, 5)])], [np.zeros(3)])
