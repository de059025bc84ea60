import mpmath
import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline

from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect, Series
from bench.base.channels import CHANNELS
from bench.base.errors import InputError
from tests.support.analysis_data import thermal_cycle

NO_THETA: dict[str, float] = {}


def at_temperatures(temperature):
    base = thermal_cycle()
    return base.select(np.arange(len(base)) < len(temperature)).with_channel("temperature", np.asarray(temperature))


def prepared_spline(intervals, ends):
    return effects.make("spline", {"intervals": intervals, "ends": ends}).prepare([thermal_cycle()])


@pytest.mark.parametrize("name", effects.effect_names())
def test_every_effect_keeps_the_protocol_and_documents_itself(name):
    effect = effects.make(name, {"formula": "k * dT_dt"} if name == "expression" else None)
    assert isinstance(effect, Effect)
    assert effect.name == name
    assert set(effect.needs) <= set(CHANNELS)
    for heading in ("Equation:", "Units:", "Source:", "When left out:", "Look-alikes:", "Separated by:"):
        assert heading in effects.doc(name)


def test_an_unknown_effect_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="unknown effect 'splin'; did you mean 'spline'"):
        effects.get("splin")
    with pytest.raises(InputError, match="no option 'interval'; did you mean 'intervals'"):
        effects.make("spline", {"interval": 3})
    with pytest.raises(InputError, match="no option 'scale'"):
        effects.make("spline", {"scale": None})


@pytest.mark.parametrize("channel", ["temperature", "frequency"])
def test_powers_of_the_raw_channel_are_exact(channel):
    record = thermal_cycle()
    series = Series.of([record], channel, 5)
    scale = series.scale
    matrix = series.powers()
    with mpmath.workdps(60):
        half = (mpmath.mpf(scale.high) - mpmath.mpf(scale.low)) / 2
        centre = mpmath.mpf(scale.low) + half
        for k in range(1, 6):
            series_of_k = mpmath.taylor(lambda x, k=k: mpmath.chebyt(k, (x - centre) / half), 0, k)
            exact = np.array([float(c) for c in series_of_k])
            np.testing.assert_allclose(matrix[: k + 1, k - 1], exact, rtol=1e-10, atol=1e-30)


def test_polynomial_columns_are_chebyshev_and_go_on_along_their_tangents():
    record = thermal_cycle()
    polynomial = effects.make("polynomial", {"order": 5}).prepare([record])
    scaled = polynomial.series.scale.unit(record.channels["temperature"])
    expected = np.polynomial.chebyshev.chebvander(scaled, 5)[:, 1:]
    np.testing.assert_allclose(polynomial.columns(record, NO_THETA), expected, atol=1e-13)
    low, high = polynomial.series.scale.low, polynomial.series.scale.high
    h = 1e-6
    ends = polynomial.columns(at_temperatures([low - 1.0, low, low + h, high - h, high, high + 2.0]), NO_THETA)
    np.testing.assert_allclose(ends[0] - ends[1], -(ends[2] - ends[1]) / h, rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(ends[5] - ends[4], 2 * (ends[4] - ends[3]) / h, rtol=1e-3, atol=1e-7)


def test_the_regression_has_the_papers_13_coefficients_with_units():
    form = effects.make("regression").prepare([thermal_cycle()]).physical()
    assert form.matrix.shape == (13, 13)
    units = dict(zip(form.labels, form.units, strict=True))
    assert units["b0"] == "deg/h"
    assert units["frequency^2"] == "deg/h/Hz^2"
    assert units["quadrature^1"] == "deg/h/V"


@pytest.mark.parametrize(("ends", "conditions"), [("natural", 2), ("parabolic", 2), ("periodic", 2), ("free", 0)])
def test_spline_bases_lose_the_constant_and_one_column_a_condition(ends, conditions):
    m = 8
    spline = prepared_spline(m, ends)
    inner = np.linspace(spline.scale.low, spline.scale.high, 400)
    columns = spline.columns(at_temperatures(inner), NO_THETA)
    assert columns.shape[1] == m + 3 - conditions - 1
    assert np.linalg.matrix_rank(np.column_stack([np.ones(400), columns])) == columns.shape[1] + 1


@pytest.mark.parametrize("ends", ["natural", "parabolic", "periodic", "free"])
def test_spline_pieces_are_the_spline_and_join_smoothly(ends):
    m, rng = 7, np.random.default_rng(3)
    spline = prepared_spline(m, ends)
    beta = rng.normal(size=spline.physical().matrix.shape[1])
    pieces = (spline.physical().matrix @ beta).reshape(m, 4)
    knots = np.array(spline.state()["knots"])
    inner = np.linspace(knots[0], knots[-1], 500)
    piece = np.clip(np.searchsorted(knots, inner, side="right") - 1, 0, m - 1)
    step = inner - knots[piece]
    by_pieces = sum(pieces[piece, j] * step**j for j in range(4))
    by_columns = beta[0] + spline.columns(at_temperatures(inner), NO_THETA) @ beta[1:]
    np.testing.assert_allclose(by_pieces, by_columns, atol=1e-12)

    width = knots[1] - knots[0]
    a0, a1, a2, a3 = pieces.T
    ends_of = np.array(
        [
            a0 + a1 * width + a2 * width**2 + a3 * width**3,
            a1 + 2 * a2 * width + 3 * a3 * width**2,
            2 * a2 + 6 * a3 * width,
        ]
    )
    np.testing.assert_allclose(ends_of[:, :-1], np.array([a0, a1, 2 * a2])[:, 1:], atol=1e-12)
    conditions = {
        "natural": [a2[0], ends_of[2, -1]],
        "parabolic": [a3[0], a3[-1]],
        "periodic": list(ends_of[1:, -1] - np.array([a1[0], 2 * a2[0]])),
        "free": [],
    }
    np.testing.assert_allclose(conditions[ends], 0.0, atol=1e-13)


@pytest.mark.parametrize(("ends", "scipys"), [("natural", "natural"), ("periodic", "periodic"), ("free", "not-a-knot")])
def test_the_basis_contains_scipys_interpolating_spline_with_the_same_ends(ends, scipys):
    """Independent construction: an interpolant through the knots with these ends is in our space."""
    m, rng = 9, np.random.default_rng(5)
    spline = prepared_spline(m, ends)
    knots = np.array(spline.state()["knots"])
    values = rng.normal(size=m + 1)
    if ends == "periodic":
        values[-1] = values[0]
    truth = CubicSpline(knots, values, bc_type=scipys)
    inner = np.linspace(knots[0], knots[-1], 400)
    columns = np.column_stack([np.ones(400), spline.columns(at_temperatures(inner), NO_THETA)])
    beta, *_ = np.linalg.lstsq(columns, truth(inner), rcond=None)
    np.testing.assert_allclose(columns @ beta, truth(inner), atol=1e-11)


def test_parabolic_ends_are_exactly_the_free_splines_without_a_third_derivative_at_the_ends():
    m = 6
    parabolic, free = prepared_spline(m, "parabolic"), prepared_spline(m, "free")
    knots = np.array(free.state()["knots"])
    inner = np.linspace(knots[0], knots[-1], 300)
    clamped = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
    third = BSpline(clamped, np.eye(m + 3), 3).derivative(3)((knots[[0, -2]] + knots[[1, -1]]) / 2)
    coefficients = np.linalg.svd(third)[2][2:].T  # all B-spline coefficients with S''' = 0 in the end intervals
    reference = BSpline(clamped, coefficients, 3)(inner)
    ours = np.column_stack([np.ones(300), parabolic.columns(at_temperatures(inner), NO_THETA)])
    assert ours.shape[1] == reference.shape[1] == m + 1
    assert np.linalg.matrix_rank(np.hstack([ours, reference]), tol=1e-9) == m + 1


def test_spline_goes_on_straight_beyond_its_ends():
    spline = prepared_spline(8, "natural")
    low, high = spline.scale.low, spline.scale.high
    columns = spline.columns(at_temperatures([low - 4, low - 2, low, high, high + 3, high + 6]), NO_THETA)
    np.testing.assert_allclose(columns[0] - columns[1], columns[1] - columns[2], atol=1e-12)
    np.testing.assert_allclose(columns[5] - columns[4], columns[4] - columns[3], atol=1e-12)


def test_gaps_in_the_temperature_are_gaps_in_the_columns():
    record = thermal_cycle()
    temperature = record.channels["temperature"].copy()
    temperature[10] = np.nan
    for name in ("polynomial", "spline", "regression"):
        effect = effects.make(name, {"intervals": 8} if name == "spline" else {}).prepare([record])
        columns = effect.columns(record.with_channel("temperature", temperature), NO_THETA)
        assert np.isnan(columns[10]).any()
        assert np.isfinite(np.delete(columns, 10, axis=0)).all()


def test_a_constant_temperature_determines_no_temperature_effect():
    record = thermal_cycle()
    still = record.with_channel("temperature", 25.0 + 0.01 * np.sin(record.time))
    for name in ("polynomial", "regression", "spline"):
        effect = effects.make(name, {"intervals": 8} if name == "spline" else {})
        with pytest.raises(InputError, match=r"temperature moves by 0\.02 degC only"):
            effect.prepare([still])


def test_an_interval_without_rows_is_named():
    record = thermal_cycle()
    temperature = record.channels["temperature"]
    hole = record.select((temperature < 30.0) | (temperature > 60.0))
    with pytest.raises(InputError, match=r"interval 15 of 24 \(32.9 to 38.1 degC\) has 0 rows"):
        effects.make("spline", {"intervals": 24}).prepare([hole]).demand([hole])


def test_only_an_automatic_spline_leaves_something_open():
    assert effects.make("spline").choices()
    assert effects.make("spline", {"intervals": 5}).choices() == ()
    assert all(variant.ends == "natural" for variant in effects.make("spline", {"ends": "natural"}).choices())
    assert not effects.make("polynomial").moves_abscissa
