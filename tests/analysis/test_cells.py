"""Splines from sums in cells: any intervals, ends and smoothing, checked against references that are not ours."""

import mpmath
import numpy as np
import pytest
from scipy.interpolate import BSpline, make_lsq_spline, make_smoothing_spline

from bench.analysis.effects.base import Scale
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.normal import held_out_rms
from bench.analysis.fit.smooth import Smoother, choose_intervals, roughness, solve_spline, spline_normal
from bench.base.errors import InputError
from bench.record.dataset import Dataset
from tests.support.thermal_cycle import curve, in_cells, record


def exact_sums(low, high, cells, x, y):
    """The sums of each cell in 60 digits."""
    with mpmath.workdps(60):
        total = [[mpmath.mpf(0)] * 12 for _ in range(cells)]
        for one, z in zip(x, y, strict=True):
            at = (mpmath.mpf(one) - mpmath.mpf(low)) * cells / (mpmath.mpf(high) - mpmath.mpf(low))
            cell = min(int(at), cells - 1)
            u = 2 * (at - cell) - 1
            for k in range(7):
                total[cell][k] += u**k
                if k < 4:
                    total[cell][7 + k] += mpmath.mpf(z) * u**k
            total[cell][11] += mpmath.mpf(z) ** 2
        return np.array([[float(value) for value in row] for row in total])


def test_sums_in_cells_are_those_of_60_digits():
    _, x, y = record(4000)
    sums = Cells(-41.0, 86.0, 12).of(x, y).reshape(12, 12)
    np.testing.assert_allclose(sums, exact_sums(-41.0, 86.0, 12, x, y), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("m", [1, 8, 24])
def test_a_spline_from_cells_is_that_of_scipy(m):
    time, x, y = record()
    low, high = x.min(), x.max()
    state = in_cells(time, x, y, ends=(low, high))
    solved = solve_spline(state.sums, state.table.sum(axis=0), m, "free")
    order = np.argsort(x)
    inner = np.linspace(low, high, m + 1)
    theirs = make_lsq_spline(x[order], y[order], np.r_[[low] * 3, inner, [high] * 3], 3)
    at = np.linspace(low, high, 997)
    np.testing.assert_allclose(curve(solved, m, "free", Scale(low, high), at), theirs(at), rtol=0, atol=1e-10)
    assert solved.rss == pytest.approx(np.sum((y - theirs(x)) ** 2), rel=1e-11)


@pytest.mark.parametrize("ends", ["natural", "parabolic", "periodic"])
def test_end_conditions_are_those_of_a_constrained_fit_in_many_digits(ends):
    """Against the KKT system of the B-spline basis, solved with 50 digits."""
    time, x, y = record(3000)
    m, low, high = 6, -41.0, 86.0
    state = in_cells(time, x, y)
    solved = solve_spline(state.sums, state.table.sum(axis=0), m, ends)
    knots = np.r_[[0.0] * 3, np.arange(m + 1.0), [float(m)] * 3]
    basis = BSpline(knots, np.eye(m + 3), 3)
    v = (x - low) * (m / (high - low))
    edges = np.array([0.0, float(m)])
    conditions = {
        "natural": basis.derivative(2)(edges),
        "parabolic": basis.derivative(3)(np.array([0.5, m - 0.5])),
        "periodic": np.array([np.diff(basis.derivative(j)(edges), axis=0)[0] for j in (1, 2)]),
    }[ends]
    columns = basis(v)
    k = len(conditions)
    with mpmath.workdps(50):
        gram = mpmath.matrix((columns.T @ columns).tolist())
        kkt = mpmath.zeros(m + 3 + k)
        kkt[: m + 3, : m + 3] = gram
        for i in range(k):
            for j in range(m + 3):
                kkt[m + 3 + i, j] = kkt[j, m + 3 + i] = mpmath.mpf(conditions[i, j])
        right = mpmath.matrix([*(columns.T @ y).tolist(), *([0] * k)])
        found = mpmath.lu_solve(kkt, right)
    truth = np.array([float(found[i]) for i in range(m + 3)])
    at = np.linspace(low, high, 301)
    theirs = basis((at - low) * (m / (high - low))) @ truth
    np.testing.assert_allclose(curve(solved, m, ends, Scale(low, high), at), theirs, rtol=0, atol=1e-9)


def test_fewer_intervals_come_from_the_same_cells_as_from_cells_of_their_own():
    time, x, y = record()
    fine, coarse = in_cells(time, x, y), in_cells(time, x, y, cells=8)
    first, second = (solve_spline(s.sums, s.table.sum(axis=0), 8) for s in (fine, coarse))
    np.testing.assert_allclose(first.beta, second.beta, rtol=1e-10, atol=1e-11)
    with pytest.raises(InputError, match="7 intervals do not divide the 96 cells"):
        solve_spline(fine.sums, fine.table.sum(axis=0), 7)


def test_a_quantised_temperature_on_borders_of_cells_is_summed_like_any_other():
    time, x, y = record(step=0.5)
    state = in_cells(time, x, y, cells=127)  # every border is a code
    weighted = state.sums.of(x, y, np.ones_like(x))
    np.testing.assert_allclose(state.table.sum(axis=0), weighted, rtol=1e-11, atol=1e-8)


def test_empty_end_cells_are_refused():
    time, x, y = record(8000)
    state = in_cells(time, x, y, ends=(-80.0, 120.0))
    total = state.table.sum(axis=0)
    with pytest.raises(InputError, match=r"not determined|0 coefficients"):
        solve_spline(state.sums, total, 96, "free")


def test_the_number_of_intervals_is_chosen_without_another_look_at_the_rows():
    time, x, y = record()
    state = in_cells(time, x, y)
    before = state.touched
    best, errors = choose_intervals(state.sums, state.grouped(state.folds(20)), (2, 3, 4, 6, 8, 12), "natural")
    assert errors[(2, 3, 4, 6, 8, 12).index(best)] == errors.min()
    smoother = Smoother.of(state.sums, state.table.sum(axis=0), 12, "natural")
    groups = spline_normal(state.sums, state.grouped(state.folds(20)), 12, "natural")
    assert {smoother.choose(c, groups).solved.rows for c in ("gcv", "reml", "blocks")} == {float(time.size)}
    assert state.touched == before == time.size


def test_a_smoothing_spline_on_its_knots_is_that_of_scipy():
    """With all rows on the knots, the natural spline of a given smoothing is the smoothing spline itself."""
    random = np.random.default_rng(3)
    knots, counts = np.linspace(-40.0, 80.0, 25), random.integers(5, 50, 25)
    means = np.sin(knots / 20.0) + random.normal(0.0, 0.1, 25)
    cells = Cells(-40.0, 80.0, 24, 0.5)
    smoother = Smoother.of(cells, cells.of(np.repeat(knots, counts), np.repeat(means, counts)), 24, "natural")
    at = np.linspace(-40.0, 80.0, 333)
    for smoothing in (1.0, 1e3, 1e5):
        theirs = make_smoothing_spline(knots, means, counts.astype(float), lam=smoothing)
        mine = curve(smoother.at(smoothing).solved, 24, "natural", Scale(-40.0, 80.0), at)
        np.testing.assert_allclose(mine, theirs(at), rtol=0, atol=1e-8)


@pytest.mark.parametrize("criterion", ["gcv", "reml"])
def test_smoothing_criteria_are_those_of_the_rows(criterion):
    """Against dense linear algebra over all rows: hat matrix, determinants."""
    time, x, y = record(1500)
    state = in_cells(time, x, y, cells=12)
    smoother = Smoother.of(state.sums, state.table.sum(axis=0), 12, "natural")
    rows = Dataset("r", time, {"temperature": x, "rate": y}, np.zeros(x.size, dtype=int))
    columns = np.column_stack([np.ones(x.size), Spline(12, "natural", Scale(-41.0, 86.0)).columns(rows, {})])
    penalty, n = roughness(state.sums, 12, "natural"), y.size

    def dense(smoothing):
        gram = columns.T @ columns + smoothing * penalty
        beta = np.linalg.solve(gram, columns.T @ y)
        rss = np.sum((y - columns @ beta) ** 2)
        if criterion == "gcv":
            return n * rss / (n - np.trace(np.linalg.solve(gram, columns.T @ columns))) ** 2
        rank = columns.shape[1] - 2
        least = rss + smoothing * beta @ penalty @ beta
        value = (n - 2) * np.log(least / (n - 2)) + np.linalg.slogdet(gram)[1]
        return value - rank * np.log(smoothing)

    offsets = [getattr(smoother, criterion)(s) - dense(s) for s in (1e2, 1e4, 1e6)]
    limit = 1e-10 if criterion == "gcv" else 1e-6
    assert np.ptp(offsets) < limit  # REML is a likelihood: a constant does not count
    best = smoother.choose(criterion)
    assert all(dense(best.smoothing) <= dense(best.smoothing * f) + 1e-9 for f in (0.5, 2.0))


def test_smoothing_by_blocks_is_the_best_of_its_neighbours():
    time, x, y = record()
    state = in_cells(time, x, y)
    groups = spline_normal(state.sums, state.grouped(state.folds(10)), 24, "natural")
    smoother = Smoother.of(state.sums, state.table.sum(axis=0), 24, "natural")
    best = smoother.choose("blocks", groups)
    assert best.criterion == held_out_rms(groups, best.smoothing * smoother.penalty)
    assert best.criterion <= min(held_out_rms(groups, best.smoothing * f * smoother.penalty) for f in (1e-3, 1e3))
