"""Errors foreseen for a run that went another way than its lot's: those that simulated truths have."""

import numpy as np
import pytest

from bench.analysis.judging.another_way import Unit, Way, simulated
from bench.analysis.noise.whitening import Ratios

BLOCK_S = 120.0
WHITE, WALK = 0.0016, 0.002
"""Variance of a mean [(deg/h)^2], and of a walk in an hour."""
NOISE = (WHITE, Ratios(0.0, WALK / WHITE))
CENTRE, SPREAD = np.array([1.0, 0.4, 0.2]), np.diag([0.5, 0.2, 0.1]) ** 2
LEVEL = np.array([1.0, 0.0, 0.0])


def way(hours, turns):
    """A path from the middle to the ends and back, and its columns: a parabola of the temperature."""
    time = BLOCK_S * (0.5 + np.arange(round(3600.0 * hours / BLOCK_S)))
    x = np.sin(2.0 * np.pi * turns * time / time[-1])
    return Way(time, 25.0 + 60.0 * x, np.column_stack([np.ones(x.size), x, x**2]), np.zeros(x.size))


SHORT, WHOLE = way(2.0, 1), way(8.0, 3)


def walk(random, rows):
    return np.cumsum(random.normal(0.0, np.sqrt(WALK * BLOCK_S / 3600.0), rows))


def lot(random, units, loop=0.0):
    """Units with their whole runs; with a loop that no column has."""
    known = random.multivariate_normal(CENTRE, SPREAD, units)
    turning = loop * np.sign(WHOLE.rates())
    found = []
    for own in known:
        noise = walk(random, WHOLE.time.size) + random.normal(0.0, np.sqrt(WHITE), WHOLE.time.size)
        whole = Way(WHOLE.time, WHOLE.degc, WHOLE.columns, WHOLE.columns @ own + turning + noise)
        fitted = np.linalg.lstsq(whole.columns, whole.bias, rcond=None)[0]
        found.append(Unit.of(whole, fitted, (CENTRE, SPREAD), NOISE, BLOCK_S))
    return found


def reached(random):
    """The error of a unit in truth: one walk through both runs, calibrated by the first."""
    own = random.multivariate_normal(CENTRE, SPREAD)
    n = SHORT.time.size
    slow = walk(random, n + WHOLE.time.size)
    y = SHORT.columns @ own + slow[:n] + random.normal(0.0, np.sqrt(WHITE), n)
    hours = SHORT.time / 3600.0
    among = WALK * np.minimum.outer(hours, hours) + WHITE * np.eye(n)
    gain = SPREAD @ SHORT.columns.T @ np.linalg.inv(SHORT.columns @ SPREAD @ SHORT.columns.T + among)
    found = CENTRE + gain @ (y - SHORT.columns @ CENTRE)
    found += LEVEL * (WALK * hours @ np.linalg.solve(among, y - SHORT.columns @ found))  # where the walk ended
    return np.sqrt(np.mean((WHOLE.columns @ (own - found) + slow[n:]) ** 2))


def test_the_errors_are_those_that_simulated_truths_have():
    random = np.random.default_rng(3)
    foreseen = np.log(simulated(SHORT, lot(random, 200), NOISE, BLOCK_S, LEVEL))
    truth = np.log([reached(random) for _ in range(400)])
    assert foreseen.mean() == pytest.approx(truth.mean(), abs=0.12)
    assert foreseen.std() == pytest.approx(truth.std(), rel=0.2)
    low, high = np.exp(foreseen.mean() + np.array([-1.96, 1.96]) * foreseen.std())
    assert 0.90 < np.mean((low < np.exp(truth)) & (np.exp(truth) < high)) < 0.99


def test_noise_that_walks_further_leaves_more():
    units = lot(np.random.default_rng(4), 20)
    still = simulated(SHORT, units, (WHITE, Ratios(0.0, 0.0)), BLOCK_S, LEVEL)
    assert np.median(simulated(SHORT, units, NOISE, BLOCK_S, LEVEL)) > np.median(still)


def test_at_a_faster_rate_what_the_model_leaves_of_the_direction_costs_more():
    faster = Way(SHORT.time / 3.0, SHORT.degc, SHORT.columns, SHORT.bias)
    errors = {}
    for loop in (0.0, 0.3):
        units = lot(np.random.default_rng(5), 30, loop)
        errors[loop] = [
            np.median(simulated(one, units, NOISE, BLOCK_S / k, LEVEL)) for one, k in ((SHORT, 1), (faster, 3))
        ]
    assert errors[0.3][1] - errors[0.3][0] > errors[0.0][1] - errors[0.0][0]
    assert errors[0.3][1] > errors[0.3][0]
