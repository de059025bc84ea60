"""The engine on records of its own making: the truth integrates states at 1 s, the candidates see 30 s means."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebvander
from numpy.testing import assert_allclose
from scipy.optimize import differential_evolution

from bench.analysis.diagnosis.candidates import Candidate, Problem, joint
from bench.analysis.diagnosis.evidence import _foremost, drawn, exceeded, weigh
from bench.analysis.diagnosis.refine import Refiner
from bench.analysis.effects.base import Parameter
from bench.analysis.effects.operators import play, ramp_invariant_lag
from bench.analysis.noise.estimate import Noise
from bench.analysis.noise.likelihood import NoiseLattice, Record, Surface, gls
from bench.analysis.noise.whitening import Whitener, covariance

NOISE = Noise(0.01, 0.03, 0.03)
LIMITS = (-41.0, 86.0)


def temperature_1s():
    """Two cycles, 3 and 6 degC/min, soaks between, behind a chamber and a housing; integrated by Euler steps."""
    setpoint = [25.0]
    for to, rate in [(85, 3), (-40, 3), (25, 3), (85, 6), (-40, 6), (25, 6)]:
        setpoint += np.linspace(setpoint[-1], to, int(abs(to - setpoint[-1]) / rate * 60)).tolist() + [to] * 900
    return euler(euler(np.array(setpoint), 60.0), 120.0)


def euler(drive, tau_s):
    state, states = drive[0], np.empty(len(drive))
    for i, value in enumerate(drive):
        state += (value - state) / tau_s
        states[i] = state
    return states


def means(values):
    rows = len(values) // 30
    return values[: rows * 30].reshape(rows, 30).mean(axis=1)


FINE = temperature_1s()
TEMPERATURE = means(FINE)
TIME = (np.arange(len(TEMPERATURE)) + 0.5) * 30.0


def columns_of(temperature, order=8):
    return chebvander(np.interp(temperature, LIMITS, (-1.0, 1.0)), order)


def bias_of(temperature):
    return 1.5 * np.cos(np.interp(temperature, LIMITS, (0.0, 5.0)))


def coloured(seed):
    dense = covariance(TIME, 30.0, NOISE.ratios(30.0)) * NOISE.white_variance(30.0)
    return np.linalg.cholesky(dense) @ np.random.default_rng(seed).normal(size=len(TIME))


SUPPLY = np.sin(TIME / 1100.0) + 0.3 * np.sin(TIME / 400.0)


def candidates():
    tau = Parameter("tau_s", "s", 20.0, 2000.0, 200.0, log=True)
    width = Parameter("half_width", "degC", 1.0, 25.0, 5.0, log=True)
    jump = Parameter("time", "s", TIME[10], TIME[-10], TIME[50])
    return [
        Candidate(
            "thermal_lag",
            lambda th: columns_of(ramp_invariant_lag(TIME, TEMPERATURE, th[0])),
            kind="abscissa",
            parameters=(tau,),
        ),
        Candidate("temperature_rate", lambda th: (60.0 * np.gradient(TEMPERATURE, TIME))[:, None]),
        Candidate("hysteresis", lambda th: play(TEMPERATURE, th[0])[:, None], parameters=(width,)),
        Candidate("supply_voltage", lambda th: SUPPLY[:, None]),
        Candidate("bias_jump", lambda th: (th[0] < TIME).astype(float)[:, None], parameters=(jump,), change_point=True),
    ]


def truth(name):
    if name == "thermal_lag":
        return means(bias_of(euler(FINE, 150.0)))
    extra = {
        "temperature_rate": lambda: 0.05 * means(np.gradient(FINE) * 60.0),
        "hysteresis": lambda: 0.05 * means(play(FINE, 6.0)),
        "supply_voltage": lambda: 0.15 * SUPPLY,
        "bias_jump": lambda: 0.35 * (TIME > 9000.0),
        "nothing": lambda: 0.0,
    }[name]()
    return means(bias_of(FINE)) + extra


def problem(name, seed=1, statics=()):
    return Problem(TIME, truth(name) + coloured(seed), columns_of(TEMPERATURE), 30.0, statics)


LATTICE = NoiseLattice(problem("nothing").records(), 30.0)  # whiteners depend on the times alone


def test_the_interval_of_the_place_of_a_jump_holds_it_as_often_as_it_says():
    """Its likelihood falls off as a random walk: ends where a smooth one would have them held it in 4 of 5 runs."""
    ends = (TIME[2], TIME[-3], TIME[50])
    place, held = Parameter("time", "s", *ends, change_point=True, jump=True), []

    def after(theta):
        return np.clip((TIME - theta[0]) / 30.0 + 0.5, 0.0, 1.0)[:, None]

    for seed in range(40):
        at = float(np.random.default_rng(seed).uniform(5000.0, TIME[-1] - 5000.0))
        record = replace(problem("nothing", seed), y=truth("nothing") + 0.25 * after([at])[:, 0] + coloured(seed))
        jump = Candidate("bias_jump", after, parameters=(place,), change_point=True)
        found = weigh(record, [jump], nulls=0, lattice=LATTICE).suspects[0]
        if found.evidence > 8.0:
            interval = found.parameters["time"]
            held.append(interval.low <= at <= interval.high)
    assert len(held) > 20
    assert np.mean(held) > 0.9


@pytest.mark.parametrize("name", ["thermal_lag", "temperature_rate", "hysteresis", "supply_voltage", "bias_jump"])
def test_a_hidden_effect_is_named(name):
    found = weigh(problem(name), candidates(), nulls=40, lattice=LATTICE)
    assert found.suspects[0].name == name
    assert found.suspects[0].evidence > found.threshold
    assert found.chance(found.suspects[0].evidence) == 0.0


def test_nothing_is_named_where_nothing_is_missing():
    found = [weigh(problem("nothing", seed), candidates(), nulls=100, lattice=LATTICE) for seed in range(3)]
    assert all(each.suspects[0].evidence <= each.threshold for each in found)


def test_chance_is_drawn_at_every_noise_that_the_data_allow():
    """Two levels of a walk that the data do not tell apart: each makes about half of the simulated runs."""
    lattice = NoiseLattice([Record(TIME, TIME, np.ones((len(TIME), 1)))], 30.0)
    allowed = Surface(lattice, lambda point: (100.0 if point == (-64, 48) else 0.0, 1.0))
    (runs,) = drawn(allowed, [(-64, -64), (-64, 32), (-64, 48)], np.random.default_rng(0), 200)
    wandering = np.std(runs, axis=0) > 2.0
    assert runs.shape == (len(TIME), 200)
    assert 80 < wandering.sum() < 120
    assert_allclose(np.std(runs[:, ~wandering]), 1.0, rtol=0.01)


def test_what_chance_reaches_does_not_grow_with_a_slow_effect():
    """Beside the base alone a line over time is taken for a walk, among which chance reaches far."""
    line = Candidate("line", lambda _: TIME[:, None] / 3600.0)
    plain = problem("nothing", 3)
    reached = []
    for dph_per_h in (0.15, 0.3):
        aged = Problem(TIME, plain.y + dph_per_h * TIME / 3600.0, plain.base, 30.0)
        found = weigh(aged, [line], nulls=60, lattice=LATTICE)
        assert 0.0 < found.suspects[0].evidence < 40.0
        reached.append(found.threshold + found.luck["line"])
    assert_allclose(reached[1], reached[0], atol=0.1)


def test_a_rival_without_hope_is_judged_in_passing_and_stays_behind():
    data = problem("supply_voltage")
    rivals = candidates()
    together = weigh(data, rivals, nulls=0, lattice=LATTICE)
    alone = {c.name: weigh(data, [c], nulls=0, lattice=LATTICE).suspects[0].evidence for c in rivals}
    for suspect in together.suspects:
        assert suspect.evidence <= alone[suspect.name] + 1e-6
    assert max(alone, key=alone.get) == together.suspects[0].name
    assert_allclose(together.suspects[0].evidence, alone[together.suspects[0].name])


def test_parameters_come_with_intervals_that_hold_the_truth():
    lag = weigh(problem("thermal_lag"), candidates()[:1], nulls=0, lattice=LATTICE).suspects[0].parameters["tau_s"]
    assert lag.low < 150.0 < lag.high
    assert lag.high - lag.low < 60.0
    hysteresis = weigh(problem("hysteresis"), candidates()[2:3], nulls=0, lattice=LATTICE).suspects[0]
    assert hysteresis.parameters["half_width"].low < 6.0 < hysteresis.parameters["half_width"].high
    assert_allclose(hysteresis.amplitudes, 0.05, atol=3.0 * hysteresis.deviations[0])


def test_the_size_beside_a_parameter_on_its_bound_is_that_at_the_bound():
    """A gap to a lag of 20 s is as good as a slope without any: size and time constant cannot be told apart."""
    tau = Parameter("tau_s", "s", 20.0, 2000.0, 200.0, log=True)

    def gap(tau_s):
        return (TEMPERATURE - ramp_invariant_lag(TIME, TEMPERATURE, tau_s))[:, None]

    data, point = problem("temperature_rate"), [Candidate("gap", lambda th: gap(th[0]), parameters=(tau,))]
    (searched,) = weigh(data, point, nulls=0, lattice=LATTICE).suspects
    (fixed,) = weigh(data, [Candidate("gap", lambda _: gap(20.0))], nulls=0, lattice=LATTICE).suspects
    assert tau.on_bound(searched.theta[0])
    assert_allclose(searched.deviations, fixed.deviations, rtol=0.05)
    assert searched.sized


def test_evidence_is_the_gain_in_likelihood_less_the_price_of_parameters():
    """Against dense algebra at the noise that the engine found: amplitudes integrated out, by determinants."""
    data = problem("supply_voltage")
    found = weigh(data, candidates()[3:4], nulls=0, lattice=LATTICE)
    suspect = found.suspects[0]

    def height(X, ratios):
        root = np.linalg.cholesky(covariance(TIME, 30.0, ratios))
        residual = np.linalg.solve(root, data.y)
        whitened = np.linalg.solve(root, X)
        residual = residual - whitened @ np.linalg.lstsq(whitened, residual)[0]
        freedom = len(TIME) - data.base.shape[1]
        prior = np.linalg.slogdet(X.T @ X)[1]
        volume = np.linalg.slogdet(whitened.T @ whitened)[1] - prior
        return freedom * np.log(residual @ residual / freedom) + 2.0 * np.log(np.diag(root)).sum() + volume

    gain = height(data.base, found.ratios) - height(joint(data, candidates()[3], ()), suspect.ratios)
    assert_allclose(suspect.evidence, gain - np.log(len(TIME)), atol=1e-6)


def test_the_threshold_of_a_few_draws_scatters_less_than_their_quantile_about_the_right_value():
    draws = np.random.default_rng(3).chisquare(1, (400, 300))
    right = 5.916  # of one degree of freedom, 1.5 %
    found = np.array([exceeded(each, 0.015) for each in draws])
    assert abs(found.mean() / right - 1.0) < 0.05
    assert found.std() < 0.9 * np.quantile(draws, 0.985, axis=1).std()


def test_a_slow_effect_costs_less_among_slow_noise_and_a_fast_one_the_same():
    data = problem("nothing")
    walk, flat = ((0, 8), (-64, -64))

    def price(column, point):
        refiner, own = Refiner(data, LATTICE), Candidate("own", lambda _: column[:, None])
        at = refiner.sigma2(own, (), point), gls(data.base, data.y, LATTICE.at([point])[0][0]).rss
        freedom = len(TIME) - data.base.shape[1]
        surface = Surface.of(data.records(), LATTICE, restricted=True)
        surface.visit([point])
        gain = freedom * np.log(at[1] / freedom) - freedom * np.log(at[0])
        return refiner.height(own, (), point) - surface.height(point) + gain + np.log(len(TIME))

    slow, fast = TIME / TIME[-1], np.where(np.arange(len(TIME)) % 2, 1.0, -1.0)
    assert_allclose([price(slow, flat), price(fast, flat)], np.log(len(TIME)), rtol=1e-6)
    assert price(slow, walk) < 0.5 * np.log(len(TIME))
    assert price(fast, walk) > 0.7 * np.log(len(TIME))


def test_cumulative_evidence_ends_at_the_fall_of_the_square_sum():
    data = problem("hysteresis")
    suspect = weigh(data, candidates()[2:3], nulls=0, lattice=LATTICE).suspects[0]
    whitener = Whitener.of(suspect.ratios, TIME, 30.0)
    before, after = (gls(X, data.y, whitener).rss for X in (data.base, joint(data, candidates()[2], suspect.theta)))
    assert_allclose(suspect.cumulative[-1], (before - after) / suspect.sigma2, rtol=1e-6)


def test_what_the_base_already_explains_is_not_excited():
    data = problem("nothing")
    own = Candidate("frequency", lambda th: 14000.0 + columns_of(TEMPERATURE)[:, 1:2])
    suspect = weigh(data, [own], nulls=0, lattice=LATTICE).suspects[0]
    assert not suspect.excited
    assert suspect.evidence < 0.0


def test_an_isothermal_record_takes_part():
    still = Record(TIME[:200], coloured(9)[:200], np.ones((200, 1)))
    found = weigh(problem("temperature_rate", statics=(still,)), candidates(), nulls=40)
    assert found.suspects[0].name == "temperature_rate"
    assert found.suspects[0].evidence > found.threshold


def test_the_same_seed_gives_the_same_answer():
    first, second = (weigh(problem("nothing"), candidates()[:3], nulls=20, seed=5, lattice=LATTICE) for _ in range(2))
    assert first.threshold == second.threshold
    assert [s.evidence for s in first.suspects] == [s.evidence for s in second.suspects]


def test_parameters_are_refined_beyond_the_grid():
    data = problem("thermal_lag")
    lag = candidates()[0]
    refiner = Refiner(data, LATTICE)
    found = weigh(data, [lag], nulls=0, lattice=LATTICE).suspects[0]
    on_grid = min(refiner.height(lag, theta, found.point) for theta in lag.grid())
    assert refiner.height(lag, found.theta, found.point) < on_grid


def late_beyond(theta):
    """What begins at a temperature, late: two parameters, one of them a place."""
    return ramp_invariant_lag(TIME, np.maximum(TEMPERATURE - theta[0], 0.0), theta[1])[:, None]


def test_no_other_search_finds_lower_parameters():
    bounds = {"centre": LIMITS, "tau_s": (20.0, 2000.0)}
    parameters = tuple(Parameter(name, "", *ends, ends[0]) for name, ends in bounds.items())
    beyond = Candidate("beyond", late_beyond, parameters=parameters, change_point=True, points=9)
    data = problem("nothing")
    data = replace(data, y=data.y + 0.02 * late_beyond((31.7, 437.0))[:, 0])
    found = weigh(data, [beyond], nulls=0, lattice=LATTICE).suspects[0]
    refiner = Refiner(data, LATTICE)
    other = differential_evolution(
        lambda theta: refiner.height(beyond, tuple(theta), found.point), list(bounds.values()), rng=1, maxiter=40
    )
    assert refiner.height(beyond, found.theta, found.point) < other.fun + 0.01


@pytest.mark.parametrize(("hope", "kept"), [(40.0, ["lag 3", "lag 2", "lag"]), (15.0, ["lag 3", "lag 2"])])
def test_the_simplest_shape_of_an_effect_is_refined_where_it_may_become_the_best(hope, kept):
    """A plain lag was named as one that differs between heating and cooling: two shapes were ahead on the grid."""
    named = {"lag 3": (20.0, 80.0), "lag 2": (19.0, 70.0), "lag": (5.0, hope)}
    shapes = [
        SimpleNamespace(candidate=SimpleNamespace(name=name, effect="lag", shift=True), rough=rough, hope=most)
        for name, (rough, most) in named.items()
    ]
    assert [one.candidate.name for one in _foremost(shapes)] == kept
