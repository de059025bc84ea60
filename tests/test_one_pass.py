"""One pass over the samples leaves sums from which every fit follows: checked against references that are not ours."""

import json
import tracemalloc
from dataclasses import replace

import mpmath
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import statsmodels.api as sm
from run_folders import CYCLE, make_run, ramp_run
from scipy import linalg
from scipy.interpolate import BSpline, make_lsq_spline, make_smoothing_spline

from bench.cli import main
from bench.control import Desk
from bench.dataset import Dataset, load
from bench.diagnosis.every_sample import of_seconds, sample_floor
from bench.effects.base import Scale, Series
from bench.effects.polynomial import Polynomial
from bench.effects.regression import Regression
from bench.effects.spline import Spline
from bench.effects.surface import Surface
from bench.effects.thermal_lag import ThermalLag
from bench.errors import InputError
from bench.fit import fit
from bench.fit.cells import STRETCH, Cells
from bench.fit.every_sample import Record, read
from bench.fit.gram import Gram, chebyshev_rows
from bench.fit.normal import held_out_rms, left_out, solve
from bench.fit.products import Products
from bench.fit.samples import BATCH_ROWS, REACH_S, Samples, between
from bench.fit.smooth import Smoother, choose_intervals, roughness, solve_spline, spline_normal
from bench.fit.so_far import SoFar
from bench.fit.state import State
from bench.model import Model
from bench.store import RunFolder

HZ = 50.0


def record(n=60_000, seed=0, step=0.0):
    """A slow cycle of temperature with sensor noise, at 50 Hz; `step` is that of the sensor [degC]."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / HZ
    temperature = 22.5 - 62.5 * np.cos(2 * np.pi * time / time[-1]) + random.normal(0.0, 0.003, n)
    if step:
        temperature = np.round(temperature / step) * step
    y = 12.0 + 3.0 * np.sin(temperature / 20.0) + 0.02 * temperature + random.normal(0.0, 1.0, n)
    return time, temperature, y


def in_cells(time, temperature, y, cells=96, ends=(-41.0, 86.0), **options):
    state = State(Cells(*ends, cells, 10.0), **options)
    state.add(time, {"temperature": temperature}, y)
    return state


def curve(solved, m, ends, scale, at):
    spline = Spline(m, ends, scale)
    rows = Dataset("at", np.arange(float(at.size)), {"temperature": at, "rate": at}, np.zeros(at.size, dtype=int))
    return solved.beta[0] + spline.columns(rows, {}) @ solved.beta[1:]


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
        "periodic": np.array([np.diff(basis.derivative(j)(edges), axis=0)[0] for j in range(3)]),
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


def test_empty_end_cells_are_refused_or_given_the_shortest_solution():
    time, x, y = record(8000)
    state = in_cells(time, x, y, ends=(-80.0, 120.0))
    total = state.table.sum(axis=0)
    with pytest.raises(InputError, match=r"not determined|0 coefficients"):
        solve_spline(state.sums, total, 96, "free")
    solved = solve_spline(state.sums, total, 96, "free", least_norm=True)
    rows = Dataset("r", time, {"temperature": x, "rate": y}, np.zeros(x.size, dtype=int))
    columns = np.column_stack([np.ones(x.size), Spline(96, "free", Scale(-80.0, 120.0)).columns(rows, {})])
    theirs = np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    assert solved.rss == pytest.approx(np.sum((y - columns @ theirs) ** 2), rel=1e-9)
    assert np.max(np.abs(solved.beta)) < 1e4


def test_gaps_are_left_out_and_nothing_stands_in_for_them():
    time, x, y = record()
    random = np.random.default_rng(1)
    x, y = x.copy(), y.copy()
    x[random.random(x.size) < 0.01] = np.nan
    y[20_000:30_000] = np.nan
    kept = np.isfinite(x) & np.isfinite(y)
    with_gaps, without = in_cells(time, x, y), in_cells(time[kept], x[kept], y[kept])
    np.testing.assert_allclose(with_gaps.table, without.table, rtol=1e-11, atol=1e-8)


def test_two_halves_merge_into_the_whole():
    time, x, y = record()
    whole = in_cells(time, x, y)
    first, second = (in_cells(time[part], x[part], y[part]) for part in (slice(0, 33_333), slice(33_333, None)))
    first.merge(second)
    assert np.array_equal(first.run, whole.run)
    np.testing.assert_allclose(first.table, whole.table, rtol=1e-11, atol=1e-8)
    with pytest.raises(InputError, match="cannot be merged"):
        first.merge(in_cells(time, x, y, ends=(-42.0, 86.0)))


def test_a_record_that_grows_has_the_sums_of_the_whole():
    time, x, y = record()
    grown = State(Cells(-41.0, 86.0, 96, 10.0))
    for start in range(0, time.size, 777):
        part = slice(start, start + 777)
        grown.add(time[part], {"temperature": x[part]}, y[part])
    np.testing.assert_allclose(grown.table, in_cells(time, x, y).table, rtol=1e-11, atol=1e-8)


def test_another_offset_changes_no_fit():
    time, x, y = record()
    state = in_cells(time, x, y)
    moved = replace(state.sums, offset=-50.0)
    first = solve_spline(state.sums, state.table.sum(axis=0), 24)
    second = solve_spline(moved, state.sums.shifted(state.table, -50.0).sum(axis=0), 24)
    np.testing.assert_allclose(first.beta, second.beta, rtol=1e-9, atol=1e-9)


# Filip and Wampler5: NIST Statistical Reference Datasets, public domain, https://www.itl.nist.gov/div898/strd/lls/
FILIP_X = """-6.860120914 -4.324130045 -4.358625055 -4.358426747 -6.955852379 -6.661145254 -6.355462942 -6.118102026
-7.115148017 -6.815308569 -6.519993057 -6.204119983 -5.853871964 -6.109523091 -5.79832982 -5.482672118
-5.171791386 -4.851705903 -4.517126416 -4.143573228 -3.709075441 -3.499489089 -6.300769497 -5.953504836
-5.642065153 -5.031376979 -4.680685696 -4.329846955 -3.928486195 -8.56735134 -8.363211311 -8.107682739
-7.823908741 -7.522878745 -7.218819279 -6.920818754 -6.628932138 -6.323946875 -5.991399828 -8.781464495
-8.663140179 -8.473531488 -8.247337057 -7.971428747 -7.676129393 -7.352812702 -7.072065318 -6.774174009
-6.478861916 -6.159517513 -6.835647144 -6.53165267 -6.224098421 -5.910094889 -5.598599459 -5.290645224
-4.974284616 -4.64454848 -4.290560426 -3.885055584 -3.408378962 -3.13200249 -8.726767166 -8.66695597
-8.511026475 -8.165388579 -7.886056648 -7.588043762 -7.283412422 -6.995678626 -6.691862621 -6.392544977
-6.067374056 -6.684029655 -6.378719832 -6.065855188 -5.752272167 -5.132414673 -4.811352704 -4.098269308
-3.66174277 -3.2644011"""
FILIP_Y = """0.8116 0.9072 0.9052 0.9039 0.8053 0.8377 0.8667 0.8809 0.7975 0.8162 0.8515 0.8766 0.8885 0.8859 0.8959
0.8913 0.8959 0.8971 0.9021 0.909 0.9139 0.9199 0.8692 0.8872 0.89 0.891 0.8977 0.9035 0.9078 0.7675
0.7705 0.7713 0.7736 0.7775 0.7841 0.7971 0.8329 0.8641 0.8804 0.7668 0.7633 0.7678 0.7697 0.77 0.7749
0.7796 0.7897 0.8131 0.8498 0.8741 0.8061 0.846 0.8751 0.8856 0.8919 0.8934 0.894 0.8957 0.9047 0.9129
0.9209 0.9219 0.7739 0.7681 0.7665 0.7703 0.7702 0.7761 0.7809 0.7961 0.8253 0.8602 0.8809 0.8301 0.8664
0.8834 0.8898 0.8964 0.8963 0.9074 0.9119 0.9228"""
FILIP = [
    -1467.48961422980, -2772.17959193342, -2316.37108160893, -1127.97394098372, -354.478233703349, -75.1242017393757,
    -10.8753180355343, -1.06221498588947, -0.670191154593408e-1, -0.246781078275479e-2, -0.402962525080404e-4,
]  # fmt: skip


def digits(found, certified):
    """Correct significant digits of the worst coefficient."""
    return -np.log10(np.max(np.abs(np.asarray(found) / np.asarray(certified) - 1.0)))


def polynomial(x, y, order):
    """Coefficients of powers from one pass, as the product makes them."""
    series = Series("temperature", order, Scale(float(x.min()), float(x.max())))
    gram = Gram.of(("temperature",), order + 1, chebyshev_rows((series,)), {"temperature": x}, y)
    state = State(gram, block_s=7.0)
    state.add(np.arange(float(x.size)), {"temperature": x}, y)
    solved = solve(gram.normal(state.table.sum(axis=0)))
    return Polynomial(order, series).physical().matrix @ solved.beta


def test_filip_has_more_than_the_digits_of_a_factorisation_of_powers():
    x, y = (np.array(text.split(), dtype=float) for text in (FILIP_X, FILIP_Y))
    assert x.size == y.size == 82
    assert digits(polynomial(x, y, 10), FILIP) > 13.0
    assert digits(np.linalg.lstsq(np.vander(x, 11, increasing=True), y)[0], FILIP) < 1.0


WAMPLER5 = """759 -2048 2048 -2048 2523 -2048 2048 -2048 1838 -2048 2048 -2048 1838 -2048 2048 -2048 2523 -2048
2048 -2048 759"""
"""Its noise in units of 10,000; the certified coefficients are all 1."""


def test_wampler5_has_more_digits_than_a_factorisation_of_powers():
    x = np.arange(21.0)
    y = sum(x**k for k in range(6)) + 1e4 * np.array(WAMPLER5.split(), dtype=float)
    assert (y[1], y[20]) == (-20479994.0, 10958421.0)
    assert digits(polynomial(x, y, 5), np.ones(6)) > 8.0
    assert digits(np.linalg.lstsq(np.vander(x, 6, increasing=True), y, rcond=None)[0], np.ones(6)) < 6.5


def quasi_run(n=20_000, seed=2):
    """Four channels of which frequency is nearly a function of temperature."""
    random = np.random.default_rng(seed)
    time, x, _ = record(n, seed)
    columns = {
        "temperature": x,
        "frequency": 9800.0 - 0.03 * x + 1e-5 * x**2 + random.normal(0.0, 0.002, n),
        "drive": 1.0 + 1e-3 * np.sin(time / 40.0),
        "quadrature": 0.05 * np.sin(time / 90.0) + random.normal(0.0, 1e-3, n),
    }
    y = 12.0 + 0.02 * x + 0.3 * np.sin(x / 15.0) + 20.0 * columns["quadrature"] + random.normal(0.0, 1.0, n)
    return time, columns, y


def regression_of(columns, y):
    needs = Regression.needs
    series = tuple(Series(c, 3, Scale(float(columns[c].min()), float(columns[c].max()))) for c in needs)
    sample = {c: columns[c][::37] for c in needs}
    return Gram.of(needs, 13, chebyshev_rows(series), sample, y[::37])


def test_thirteen_coefficients_are_those_of_many_digits_although_frequency_nearly_follows_temperature():
    time, columns, y = quasi_run(4000)
    gram = regression_of(columns, y)
    state = State(gram)
    state.add(time, columns, y)
    solved = solve(gram.normal(state.table.sum(axis=0)))
    assert solved.condition > 100.0
    design = np.empty((13, y.size))
    gram.design(columns, design)
    with mpmath.workdps(50):
        a = mpmath.matrix(design.tolist())
        b = mpmath.matrix(y.tolist())
        truth = mpmath.lu_solve(a * a.T, a * b)
        fitted = np.array([float(v) for v in (a.T * truth)])
    assert np.max(np.abs(design.T @ solved.beta - fitted)) < 1e-12 * np.max(np.abs(fitted))
    theirs = sm.OLS(y, design.T).fit(method="qr")
    assert solved.rss == pytest.approx(theirs.ssr, rel=1e-11)
    assert solved.condition == pytest.approx(np.linalg.cond(design.T / np.linalg.norm(design.T, axis=0)), rel=1e-6)


def test_the_gram_matrix_that_is_summed_is_well_conditioned():
    time, columns, y = quasi_run()
    gram = regression_of(columns, y)
    state = State(gram)
    state.add(time, columns, y)
    form = gram.normal(state.table.sum(axis=0))
    scale = np.sqrt(np.diag(form.gram))
    plain = Gram(gram.needs, 13, gram.design, np.eye(14))
    raw = plain.normal(plain.sums(columns, y))
    raw_scale = np.sqrt(np.diag(raw.gram))
    assert np.linalg.cond(form.gram / np.outer(scale, scale)) < 1e-2 * np.linalg.cond(
        raw.gram / np.outer(raw_scale, raw_scale)
    )


@pytest.mark.parametrize("order", [1, 2, 3, 5, 7])
def test_a_surface_from_sums_of_products_is_that_of_its_columns(order):
    random = np.random.default_rng(order)
    time, x, _ = record(9000)
    rate = random.uniform(-300.0, 300.0, x.size)
    y = 5.0 + 0.01 * rate + 1e-5 * rate * x + random.normal(0.0, 1.0, x.size)
    pair = (Series("applied_rate", order, Scale(-300.0, 300.0)), Series("temperature", order, Scale(-41.0, 86.0)))
    surface = Surface(order, series=pair)
    products = Products(*pair, surface.terms, 3.0)
    state = State(products)
    state.add(time, {"applied_rate": rate, "temperature": x}, y)
    solved = solve(products.normal(state.table.sum(axis=0)))
    rows = Dataset("r", time, {"applied_rate": rate, "temperature": x, "rate": y}, np.zeros(x.size, dtype=int))
    columns = np.column_stack([np.ones(x.size), surface.columns(rows, {})])
    theirs = linalg.lstsq(columns, y)[0]
    np.testing.assert_allclose(solved.beta, theirs, rtol=0, atol=1e-11)
    assert solved.rss == pytest.approx(np.sum((y - columns @ theirs) ** 2), rel=1e-10)


def test_blocks_left_out_are_predicted_as_by_a_fit_without_their_rows():
    time, x, y = record()
    state = in_cells(time, x, y)
    label = state.folds(5)
    squares = left_out(spline_normal(state.sums, state.grouped(label), 8, "natural"))
    block = np.floor(time / state.block_s).astype(int)
    for fold in range(5):
        out = np.isin(block, np.flatnonzero(label == fold))
        part = in_cells(time[~out], x[~out], y[~out])
        solved = solve_spline(part.sums, part.table.sum(axis=0), 8)
        residual = y[out] - curve(solved, 8, "natural", Scale(-41.0, 86.0), x[out])
        assert squares[fold] == pytest.approx(np.sum(residual**2), rel=1e-9)


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


def test_readings_of_a_slow_channel_are_joined_by_straight_lines_and_not_across_gaps():
    time = np.arange(0.0, 10.0, 0.1)
    values = np.full(time.size, np.nan)
    values[[0, 10, 20, 60, 70]] = [0.0, 1.0, 0.0, 5.0, 6.0]
    found = between(time, values, slice(None))
    assert found[5] == pytest.approx(0.5)
    assert found[15] == pytest.approx(0.5)
    assert time[60] - time[20] > REACH_S
    assert np.all(np.isnan(found[21:60]))
    assert np.all(np.isnan(found[71:]))
    table = between(time, values, slice(None), "applied_rate")  # it accelerates all the time
    assert np.flatnonzero(np.isfinite(table)).tolist() == [0, 10, 20, 60, 70]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run at 20 Hz whose temperature comes with every fourth sample only."""
    made = ramp_run(CYCLE, rate_hz=20.0)
    columns = made["columns"]
    for name in ("temperature", "frequency", "drive", "quadrature"):
        slow = np.full(columns[name].size, np.nan)
        slow[::4] = columns[name][::4]
        columns[name] = slow
    return RunFolder(make_run(tmp_path_factory.mktemp("runs") / "run", **made))


def as_record(folder):
    return Record(Samples(folder.data), load(folder.path, 1.0), load(folder.path))


def test_every_sample_is_read_once_however_many_models_there_are(run, monkeypatch):
    opened = []
    original = pq.ParquetFile.iter_batches
    monkeypatch.setattr(
        pq.ParquetFile, "iter_batches", lambda self, **given: opened.append(1) or original(self, **given)
    )
    models = [Model("p", (Polynomial(),)), Model("r", (Regression(),)), Model("s", (Spline(),))]
    rows = pq.read_metadata(run.data).num_rows
    assert rows > BATCH_ROWS > STRETCH
    passes = read(models, [as_record(run)])
    assert [one.state.touched for one in passes] == [rows] * 3
    assert len(opened) == 1


def test_memory_does_not_grow_with_the_record(tmp_path):
    """Allocations of Python and numpy while a file is read: four times the samples, the same peak."""
    peaks = []
    for rows in (1 << 19, 1 << 21):
        time = np.arange(rows) / 500.0
        columns = {"time": time, "rate": np.sin(time), "temperature": 20.0 + np.cos(time / 300.0)}
        pq.write_table(pa.table(columns), path := tmp_path / f"{rows}.parquet", row_group_size=1 << 18)
        samples, state = Samples(path), State(Cells(19.0, 21.0, 96))
        tracemalloc.start()
        for batch in samples.read(["temperature"]):
            state.add(batch.time, batch.columns, batch.y)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert state.touched == rows
    assert peaks[1] < 1.3 * peaks[0] < 50e6


@pytest.mark.parametrize(
    "effects", [(Polynomial(4),), (Regression(),), (Spline(24),), (Spline(12), ThermalLag())], ids=str
)
def test_a_fit_to_every_sample_is_the_fit_to_the_rows(run, effects):
    """The same rows, joined by straight lines beforehand, through the ordinary fit."""
    (one,) = read([Model("m", effects)], [as_record(run)])
    found = one.fit([as_record(run)])
    table = pq.read_table(run.data).to_pandas()
    time = table["time"].to_numpy()
    channels = {name: table[name].to_numpy() for name in ("rate", *Regression.needs)}
    for name in Regression.needs:
        known = np.isfinite(channels[name])
        channels[name] = np.interp(time, time[known], channels[name][known], right=np.nan)
    rows = Dataset("all", time, channels, table["segment"].to_numpy().astype(int), interval_s=0.05)
    if len(effects) == 1:
        ours = fit(Model("m", effects), rows, covariance="none")
        at = rows.select(np.arange(time.size) % 501 == 0)
        np.testing.assert_allclose(found.predict(at).bias, ours.predict(at).bias, rtol=0, atol=2e-4)
        assert found.rms_dph == pytest.approx(ours.rms_dph, rel=1e-6)
        assert found.rows == ours.rows
    else:  # the lag's columns come from 1 s means
        means = fit(Model("m", effects), load(run.path), covariance="none")
        at = load(run.path)
        assert np.nanmax(np.abs(found.predict(at).bias - means.predict(at).bias)) < 0.05
        assert found.theta == means.theta


def test_heating_alone_is_fitted_from_the_blocks_that_heat(run):
    both, heating = read([Model("m", (Polynomial(),)), Model("m", (Polynomial(),), "heating")], [as_record(run)])
    assert 0 < heating.solved().rows < both.solved().rows
    assert both.solved(heating.rows).beta == pytest.approx(heating.solved().beta)


def test_compare_every_sample_answers_like_compare(run, capsys):
    def say(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["compare", str(run.path), "--json", "--model", "polynomial", "--model", "spline", *arguments])
        assert end.value.code == 0
        return json.loads(capsys.readouterr().out)

    means, samples = say(), say("--every-sample")
    assert set(means) <= set(samples)
    assert samples["samples"] == pq.read_metadata(run.data).num_rows
    for ours, theirs in zip(samples["models"], means["models"], strict=True):
        assert set(ours) == set(theirs)
        assert ours["rms_dph"] <= ours["held_out_rms_dph"]
        assert [s["name"] for s in ours["segments"]] == [s["name"] for s in theirs["segments"]]
    # White noise of single samples is what is left, and the floor knows it.
    assert samples["models"][1]["rms_dph"] / samples["floor_dph"] == pytest.approx(1.0, abs=0.15)


def test_the_floor_of_single_samples_holds_their_scatter_inside_the_seconds(run):
    seconds = load(run.path, 1.0)
    inside = np.nanmean(seconds.variances["rate"])
    assert sample_floor([seconds], 0.5) == pytest.approx(np.sqrt(0.25 + 0.95 * inside), rel=1e-3)


def test_the_error_of_1_s_means_follows_from_that_of_the_samples(run):
    """Against the residuals of the means themselves."""
    seconds = load(run.path, 1.0)
    (one,) = read([Model("m", (Polynomial(),))], [as_record(run)])
    found = one.fit([as_record(run)])
    residual = seconds.bias - found.predict(seconds).bias
    rms = np.sqrt(np.nansum(seconds.count("rate") * residual**2) / np.sum(seconds.count("rate")))
    assert of_seconds(found.rms_dph, [seconds]) == pytest.approx(rms, rel=1e-3)


def test_a_check_run_is_refused_with_what_to_do(run, capsys):
    with pytest.raises(SystemExit) as end:
        main(["compare", str(run.path), "--every-sample", "--check", str(run.path)])
    assert end.value.code == 2
    assert "a check run is scored on means" in capsys.readouterr().err


def test_a_live_run_is_followed_from_its_means():
    so_far, random = SoFar(-40.0, 85.0), np.random.default_rng(0)
    assert so_far.report() is None
    for second in range(3600):
        degc = -40.0 + second / 60.0
        so_far.add(second + 0.5, degc, 12.0 + 3.0 * np.sin(degc / 5.0) + random.normal(0.0, 0.5))
        so_far.add(second + 0.6, np.nan, 1.0)
    so_far.add(3601.0, 200.0, 1.0)
    report = json.loads(json.dumps(so_far.report(), allow_nan=False))
    polynomial, spline = report["models"]
    assert (report["seconds"], report["outside"]) == (3600, 1)
    assert (report["from_degc"], report["to_degc"]) == (-40.0, pytest.approx(20.0, abs=0.1))
    assert spline["rms_dph"] == pytest.approx(0.5, rel=0.1)
    assert spline["held_out_rms_dph"] >= spline["rms_dph"]
    assert polynomial["rms_dph"] > 1.5


def test_notes_of_others_are_in_the_status_of_a_live_run():
    desk = Desk()
    desk.notes = lambda: {"fits": {"G-1": {"seconds": 60}}}
    assert desk.status()["fits"] == {"G-1": {"seconds": 60}}
