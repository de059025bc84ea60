import numpy as np
from numpy.testing import assert_allclose

from bench.analysis.diagnosis.candidates import Problem
from bench.analysis.diagnosis.limits import probability, smallest
from bench.analysis.noise.likelihood import NoiseLattice
from bench.analysis.noise.whitening import covariance
from tests.analysis.test_evidence import NOISE, TEMPERATURE, TIME, bias_of, candidates, coloured, columns_of

DATA = Problem(TIME, bias_of(TEMPERATURE) + coloured(1), columns_of(TEMPERATURE), 30.0)
LATTICE = NoiseLattice(DATA.records(), 30.0)
POINT = (-16, -16)  # ratios of 0.1
SIGMA2 = NOISE.white_variance(30.0)


def test_smallest_amplitude_agrees_with_dense_algebra():
    rate = candidates()[1]
    limit = smallest(DATA, rate, (), LATTICE, POINT, SIGMA2)
    root = np.linalg.cholesky(covariance(TIME, 30.0, LATTICE.ratios(POINT)))
    white = np.linalg.solve(root, np.column_stack([DATA.base, rate.columns(())]))
    outside = white[:, -1] - white[:, :-1] @ np.linalg.lstsq(white[:, :-1], white[:, -1])[0]
    assert_allclose(limit.amplitude**2 * (outside @ outside) / SIGMA2, 20.0, rtol=1e-8)
    assert_allclose(limit.rms_dph, limit.amplitude * rate.columns(()).std(), rtol=1e-12)


def test_an_effect_that_the_base_absorbs_has_no_limit():
    kept = candidates()[3]
    absorbed = type(kept)("frequency", lambda th: columns_of(TEMPERATURE)[:, 2:3])
    assert smallest(DATA, absorbed, (), LATTICE, POINT, SIGMA2).amplitude == np.inf


def test_a_lag_has_a_least_time_constant_that_shows():
    limit = smallest(DATA, candidates()[0], (), LATTICE, POINT, SIGMA2)
    assert 20.0 <= limit.theta[0] < 200.0


def test_a_gap_of_twenty_is_found_nineteen_times_in_twenty():
    assert_allclose(probability(20.0), 0.94, atol=0.005)
    assert probability(0.0) == 0.0
