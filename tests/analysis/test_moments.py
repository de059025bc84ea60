"""Moments stand for the rows: what is solved from them is the fit to the rows."""

from dataclasses import replace

import numpy as np
import pytest

from bench.analysis.effects.model import Model
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.spline import Spline
from bench.analysis.effects.thermal_lag import ThermalLag
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.from_moments import check, solve_moments
from bench.analysis.fit.moments import SIZE, Moments, merged
from bench.base.errors import InputError
from tests.support.analysis_data import thermal_cycle, with_bias

EFFECTS = [
    *(Polynomial(order) for order in (1, 3, 5, 12)),
    *(Regression(order) for order in (1, 3)),
    *(Spline(m, ends) for m in (3, 8, 24) for ends in ("natural", "parabolic", "periodic", "free")),
    Spline(1, "free"),
]


def model(effect):
    return Model("m", (effect,))


def record(seed=1, constant=12.0):
    random = np.random.default_rng(seed)
    cycle = thermal_cycle()
    x = cycle.channel("temperature") / 60.0
    bias = constant + 3.0 * x - 2.0 * x**2 + 0.4 * np.sin(4 * x) + random.normal(0.0, 0.1, x.size)
    counts = random.choice([15000.0, 15000.0, 15000.0, 9000.0, 0.0], x.size)
    rows = with_bias(cycle, np.where(counts > 0, bias, np.nan))
    return replace(rows, counts={"rate": counts})


def agree(moments, effect, records, tolerance=1e-9):
    direct = fit_model(model(effect), records, covariance="none", weights="count")
    solved = solve_moments(model(effect), moments)
    scale = np.max(np.abs(direct.beta))
    np.testing.assert_allclose(solved.beta, direct.beta, rtol=0, atol=tolerance * scale)
    assert solved.rms_dph == pytest.approx(direct.rms_dph, rel=tolerance)
    assert solved.condition == pytest.approx(direct.condition, rel=1e-6)
    assert solved.rows == direct.rows
    assert solved.validity == direct.validity
    mine = [solved.bound.columns(one) @ solved.beta for one in records]
    for own, one in zip(mine, records, strict=True):
        np.testing.assert_allclose(own, direct.predict(one).bias, rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("effect", EFFECTS, ids=str)
def test_a_fit_from_moments_is_the_fit_to_the_rows(effect):
    one = record()
    agree(Moments.of([one]), effect, [one])


@pytest.mark.parametrize("constant", [-1e5, 0.0, 1e5])
def test_a_large_bias_costs_no_digits_of_the_residual(constant):
    one = record(constant=constant)
    for effect in (Polynomial(3), Regression(3), Spline(12)):
        direct = fit_model(model(effect), one, covariance="none", weights="count")
        solved = solve_moments(model(effect), Moments.of([one]))
        assert solved.rms_dph == pytest.approx(direct.rms_dph, rel=1e-9)


@pytest.mark.parametrize("effect", [Polynomial(5), Regression(3), Spline(12)], ids=str)
def test_moments_of_two_runs_merge_into_those_of_both(effect):
    first, second = record(1), record(2, constant=-40.0)
    ranges = {}
    for channel in Regression.needs:
        values = np.concatenate([r.channel(channel)[np.isfinite(r.bias)] for r in (first, second)])
        ranges[channel] = (float(values.min()), float(values.max()))
    both = merged(Moments.of([first], ranges), Moments.of([second], ranges))
    agree(both, effect, [first, second])


@pytest.mark.parametrize("effect", [Polynomial(5), Regression(3), Spline(12)], ids=str)
def test_a_record_that_grows_block_by_block_has_the_moments_of_the_whole(effect):
    whole = record()
    finite = np.isfinite(whole.bias)
    ranges = {
        c: (float(whole.channel(c)[finite].min()), float(whole.channel(c)[finite].max())) for c in Regression.needs
    }
    blocks = np.array_split(np.arange(len(whole)), 9)
    parts = [Moments.of([whole.select(np.isin(np.arange(len(whole)), block))], ranges) for block in blocks]
    grown = parts[0]
    for part in parts[1:]:
        grown = merged(grown, part)
    agree(grown, effect, [whole])


def test_a_packed_state_is_the_state():
    moments = Moments.of([record()])
    packed = moments.pack()
    assert packed.shape == (SIZE,)
    assert np.array_equal(Moments.unpack(packed).pack(), packed)
    first, second = (solve_moments(model(Spline(12)), state) for state in (moments, Moments.unpack(packed)))
    assert np.array_equal(first.beta, second.beta)


def test_damaged_moments_are_refused():
    packed = Moments.of([record()]).pack()
    for damaged in (packed[:-1], np.where(np.arange(SIZE) == 400, np.nan, packed)):
        with pytest.raises(InputError, match="moments are damaged"):
            Moments.unpack(damaged)


def test_a_channel_that_is_missing_or_stands_still_takes_only_its_model_away():
    one = record()
    still = one.with_channel("drive", np.ones(len(one)))
    missing = replace(one, channels={name: one.channels[name] for name in ("rate", "temperature")})
    for without in (still, missing):
        moments = Moments.of([without])
        agree(moments, Polynomial(3), [without])
        with pytest.raises(InputError, match="has no value in the rows"):
            solve_moments(model(Regression()), moments)


def test_moments_over_different_ranges_do_not_merge():
    moments = Moments.of([record()])
    with pytest.raises(InputError, match="cannot be merged"):
        merged(moments, replace(moments, ranges=moments.ranges * 2))


def test_an_interval_without_rows_is_refused_as_by_the_fit():
    one = record()
    gap = (one.channel("temperature") > 30.0) & (one.channel("temperature") < 50.0)
    moments = Moments.of([one.select(~gap)])
    with pytest.raises(InputError, match=r"interval \d+ of 24 \(.*\) has 0 rows"):
        solve_moments(model(Spline(24)), moments)


@pytest.mark.parametrize("effect", [Spline(), Spline(7), Regression(4), ThermalLag()], ids=str)
def test_what_moments_cannot_say_is_refused_with_what_they_can(effect):
    with pytest.raises(InputError, match="cannot be solved from moments: allowed are"):
        check(model(effect))


def test_a_record_at_one_temperature_has_no_moments():
    one = record()
    with pytest.raises(InputError, match="temperature moves by"):
        Moments.of([one.with_channel("temperature", np.full(len(one), 25.0))])
