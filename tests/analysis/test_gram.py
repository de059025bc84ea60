"""Sums of products keep the digits of an orthogonal factorisation: NIST data, many digits, near collinearity."""

import mpmath
import numpy as np
import pytest
import statsmodels.api as sm
from scipy import linalg

from bench.analysis.effects.base import Scale, Series
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.surface import Surface
from bench.analysis.fit.gram import ChebyshevRows, Gram
from bench.analysis.fit.normal import solve
from bench.analysis.fit.products import Products
from bench.analysis.fit.state import State
from bench.record.dataset import Dataset
from tests.support.thermal_cycle import record

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
    gram = Gram.of(("temperature",), order + 1, ChebyshevRows((series,)), {"temperature": x}, y)
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
    return Gram.of(needs, 13, ChebyshevRows(series), sample, y[::37])


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
