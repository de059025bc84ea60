import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.analysis.noise.whitening import Ratios, Recursion, Whitener, covariance

RATIOS = [Ratios(), Ratios(0.08, 0.08), Ratios(30.0, 30.0), Ratios(0.0, 10.0), Ratios(100.0, 1e-3)]


def gapped_times(rows=400):
    rng = np.random.default_rng(0)
    kept = rng.random(rows) > 0.1
    kept[150:220] = False
    return (np.arange(rows) * 30.0 + 15.0)[kept]


@pytest.mark.parametrize("ratios", RATIOS)
@pytest.mark.parametrize(
    "time_s", [np.arange(333) * 30.0, gapped_times(), np.arange(7) * 30.0], ids=["whole", "gapped", "short"]
)
def test_recursion_agrees_with_dense_cholesky(ratios, time_s):
    matrix = np.random.default_rng(1).normal(size=(len(time_s), 3))
    white = np.random.default_rng(2).uniform(1.0, 3.0, len(time_s))
    whitener = Whitener.of(ratios, time_s, 30.0, white)
    dense = covariance(time_s, 30.0, ratios, white)
    assert_allclose(whitener.apply(matrix), np.linalg.solve(np.linalg.cholesky(dense), matrix), atol=1e-11)
    assert_allclose(whitener.apply(matrix[:, 0]), whitener.apply(matrix)[:, 0])
    assert_allclose(whitener.log_det, np.linalg.slogdet(dense)[1], rtol=1e-12)


@pytest.mark.parametrize("ratios", [Ratios(1e6, 0.0), Ratios(0.0, 1e6), Ratios(1e3, 1e3)])
@pytest.mark.parametrize("apart_s", [25.0, 17.5, 7.5, 2.0])
def test_means_beside_gaps_have_a_positive_covariance(ratios, apart_s):
    time_s = np.arange(100) * 30.0 + 15.0
    time_s[40] = time_s[41] - apart_s
    time_s[70:] = time_s[69] + apart_s + 30.0 * np.arange(30)
    dense = covariance(time_s, 30.0, ratios)
    assert np.linalg.eigvalsh(dense)[0] > 0.0
    white = Whitener.of(ratios, time_s, 30.0).apply(np.eye(100))
    np.testing.assert_allclose(white @ dense @ white.T, np.eye(100), atol=1e-6)


def test_many_ratios_at_once_are_the_same_as_one_by_one():
    time_s = gapped_times(100)
    vector = np.sin(time_s)
    for ratios, together in zip(RATIOS, Recursion(time_s, 30.0).whiteners(RATIOS), strict=True):
        assert_allclose(together.apply(vector), Whitener.of(ratios, time_s, 30.0).apply(vector), rtol=1e-13)


def test_colouring_undoes_whitening():
    time_s = gapped_times(100)
    whitener = Whitener.of(Ratios(0.3, 0.2), time_s, 30.0)
    matrix = np.random.default_rng(3).normal(size=(len(time_s), 70))
    assert_allclose(whitener.apply(whitener.colour(matrix)), matrix, atol=1e-12)
    assert whitener.apply(whitener.colour(matrix[:, :0])).shape == (len(time_s), 0)


def test_whitening_is_causal():
    time_s = np.arange(100) * 30.0
    whitener = Whitener.of(Ratios(0.3, 0.2), time_s, 30.0)
    late = np.zeros(100)
    late[60:] = 1.0
    assert not whitener.apply(late)[:60].any()


def averaged(fine, group):
    rows = len(fine) // group
    return fine.reshape(rows, group, rows, group).mean(axis=(1, 3))


def test_covariance_of_means_is_the_mean_of_the_covariance():
    """Independent route: sums of OU and walk sampled finely, averaged over the bins."""
    group, rows, interval = 60, 8, 30.0
    fine_s = (np.arange(rows * group) + 0.5) * interval / group
    lag = np.abs(fine_s[:, None] - fine_s[None, :])
    taus = interval * 4.0 ** np.arange(-1, 8)
    flicker = sum(np.log(4.0) / np.pi * np.exp(-lag / tau) for tau in taus)
    walk = np.minimum(fine_s[:, None], fine_s[None, :]) / 3600.0
    time_s = (np.arange(rows) + 0.5) * interval
    made = covariance(time_s, interval, Ratios(1.0, 0.0), np.zeros(rows))
    expected = averaged(flicker, group)
    off = ~np.eye(rows, dtype=bool)
    assert_allclose(made[off], expected[off], rtol=1e-4)
    # The diagonal holds the time constants below the first as well, a geometric series of white noise.
    assert_allclose(np.diag(made) - np.diag(expected), np.log(4.0) / np.pi * 0.5 / 3.0, rtol=5e-3)
    assert_allclose(covariance(time_s, interval, Ratios(0.0, 1.0), np.zeros(rows)), averaged(walk, group), rtol=3e-4)


def test_flicker_has_the_spectrum_of_ieee_952():
    """S(f) = B^2 / (2 pi f): the variogram of means of 1/f noise about lag m grows by B^2/pi ln 2 an octave of lag."""
    dense = covariance(np.arange(2000) * 30.0, 30.0, Ratios(1.0, 0.0), np.zeros(2000))
    for lag in (50, 200, 800):
        assert_allclose(dense[0, lag] - dense[0, 2 * lag], np.log(2.0) / np.pi, rtol=0.05)
