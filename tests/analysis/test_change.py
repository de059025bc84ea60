"""Before and after a calibration: one definition on both sides, at rest and turning apart."""

from __future__ import annotations

import numpy as np
import pytest

from bench.analysis.judging.change import Change, Figures
from bench.base import InputError
from bench.record import Dataset


def dataset(counts=None, **channels):
    rows = len(channels["rate"])
    return Dataset("record", np.arange(rows) * 30.0, channels, np.zeros(rows, dtype=int), (), 30.0, counts or {})


def turned(error_dph, temperature, rate_dps=None):
    """A record whose output is wrong by `error_dph`, on a table that turns at `rate_dps`."""
    channels = {"temperature": temperature, "rate": np.asarray(error_dph, dtype=float)}
    if rate_dps is not None:
        channels |= {"applied_rate": rate_dps, "rate": channels["rate"] + 3600.0 * rate_dps}
    return dataset(**channels)


def test_rms_is_about_zero_on_both_sides_and_the_scatter_about_the_mean():
    temperature = np.linspace(-10.0, 50.0, 100)
    before, after = 20.0 + 3.0 * np.sin(np.arange(100)), 0.1 * np.cos(np.arange(100)) + 0.2
    change = Change.between(turned(before, temperature), turned(after, temperature))
    assert change.factor == pytest.approx(np.sqrt(np.mean(before**2) / np.mean(after**2)))
    assert change.before.rest.scatter_dph == pytest.approx(np.std(before))
    assert change.after.rest.scatter_dph == pytest.approx(np.std(after))
    assert np.isnan(change.turning_factor)
    assert change.words == f"{change.factor:.1f} times less at rest than before"


def test_rotation_does_not_enter_the_figures_at_rest():
    temperature, rate = np.linspace(-10.0, 50.0, 90), np.repeat([0.0, 100.0, -100.0], 30)
    before, after = np.where(rate, 3600.0 * 0.001 * rate, 2.0), np.where(rate, 5.0, 0.5)
    change = Change.between(turned(before, temperature, rate), turned(after, temperature, rate))
    assert change.factor == pytest.approx(4.0)
    assert change.turning_factor == pytest.approx(72.0)
    assert change.to_json()["turning_after"]["rms_dph"] == pytest.approx(5.0)


def test_only_temperatures_that_both_records_have_are_compared():
    hot = np.linspace(0.0, 80.0, 81)
    before = turned(np.where(hot > 40.0, 100.0, 1.0), hot)
    change = Change.between(before, turned(np.full(41, 0.5), np.linspace(0.0, 40.0, 41)))
    assert change.within_degc == (0.0, 40.0)
    assert change.factor == pytest.approx(2.0)


@pytest.mark.parametrize("after_degc", [np.linspace(0, 10, 9), np.full(9, 53.0)], ids=["elsewhere", "between two rows"])
def test_records_without_a_common_temperature_are_not_compared(after_degc):
    before, after = turned(np.ones(9), np.linspace(50, 60, 9)), turned(np.ones(9), after_degc)
    change = Change.between(before, after)
    assert change.before is None
    assert change.to_json()["factor"] is None
    assert change.words == ""


def test_a_mean_counts_by_its_samples():
    data = dataset(counts={"rate": np.array([3.0, 1.0])}, temperature=np.zeros(2), rate=np.array([0.0, 4.0]))
    assert Figures.of(data).mean_dph == pytest.approx(1.0)
    with pytest.raises(InputError, match="holds no rate"):
        Figures.of(data, np.full(2, np.nan))
