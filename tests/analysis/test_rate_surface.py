"""The second paper's surface: 21 coefficients from steps of rate and of temperature, two ways that must agree."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from bench.analysis.fit.rate_surface import (
    Points,
    binned,
    fit_surface,
    monomials,
    orthogonal,
    points_of,
    surface_powers,
)
from bench.base.errors import InputError

RATES = (-300.0, -200.0, -100.0, -50.0, -10.0, 0.0, 10.0, 50.0, 100.0, 200.0, 300.0)
DEGC = (-55.0, -40.0, -20.0, 0.0, 25.0, 50.0, 75.0, 100.0, 125.0)


def raw_of(rate, celsius):
    """What a unit with a temperature-dependent scale factor and bias says, in deg/s."""
    x, t = rate / 300.0, celsius / 90.0
    return rate * (1.0 + 0.004 * t + 0.001 * t**2 - 0.002 * x**2) + 0.02 + 0.01 * t**3 - 0.003 * x**2 * t


def experiment(seed: int = 0, noise: float = 0.0):
    """Rate steps at fixed temperatures, then temperature steps at fixed rates, 20 samples each; soaks are longer."""
    pairs = [(r, t) for t in DEGC for r in RATES] + [(r, t) for r in (-150.0, 150.0) for t in range(-55, 126, 15)]
    rows = [(r, t, k) for r, t in pairs for k in range(60 if r == 0.0 else 20)]
    rate, celsius, k = np.array(rows).T
    celsius = celsius + 0.01 * k / 20.0
    return raw_of(rate, celsius) + noise * np.random.default_rng(seed).normal(size=rate.size), celsius, rate


def test_the_order_of_the_coefficients_is_by_total_degree():
    assert surface_powers(5)[:6] == ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    assert len(surface_powers(5)) == 21
    assert surface_powers(5)[20] == (0, 5)


def test_a_surface_of_fifth_order_is_found_again_to_its_last_digits():
    powers = surface_powers(5)
    truth = np.random.default_rng(3).normal(size=21) * np.array([0.1 ** (i + j) for i, j in powers])
    raw, celsius, _ = experiment()
    found = fit_surface(Points(raw, celsius, monomials(raw / 300.0, celsius / 90.0, 5) @ truth))
    wanted = truth / np.array([300.0**i * 90.0**j for i, j in powers])
    np.testing.assert_allclose(found.coefficients, wanted, rtol=1e-7, atol=1e-18)


def test_least_squares_and_orthogonal_polynomials_agree():
    points = binned(*experiment(noise=0.001))
    found = fit_surface(points)
    other = orthogonal(found.raw.unit(points.raw), found.temperature.unit(points.temperature), points.reference, 5)
    np.testing.assert_allclose(found.normalised, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
    assert found.disagreement < 1e-12


def test_least_squares_is_that_of_fifty_digits():
    points = binned(*experiment(noise=0.001))
    found = fit_surface(points)
    columns = monomials(found.raw.unit(points.raw), found.temperature.unit(points.temperature), 5)
    with mpmath.workdps(50):
        matrix, y = mpmath.matrix(columns.tolist()), mpmath.matrix(points.reference.tolist())
        exact = mpmath.lu_solve(matrix.T * matrix, matrix.T * y)
        worst = max(abs(a - b) for a, b in zip(exact, found.normalised.tolist(), strict=True))
    assert float(worst) < 1e-11


def test_denormalised_coefficients_are_the_same_surface():
    found = fit_surface(binned(*experiment()))
    raw, celsius = np.array([-250.0, 3.0, 299.0]), np.array([-50.0, 25.0, 120.0])
    with mpmath.workdps(40):
        for r, t, wanted in zip(raw, celsius, found.predict(raw, celsius)[0], strict=True):
            pairs = zip(found.coefficients.tolist(), found.powers, strict=True)
            total = mpmath.fsum(mpmath.mpf(c) * mpmath.mpf(r) ** i * mpmath.mpf(t) ** j for c, (i, j) in pairs)
            assert float(total) == pytest.approx(wanted, abs=1e-9)


def test_outside_the_box_the_surface_is_clamped_and_flagged():
    found = fit_surface(binned(*experiment()))
    ends = found.raw.high, found.temperature.high
    at_edge, inside = found.predict(np.array([ends[0]]), np.array([ends[1]]))
    beyond, outside = found.predict(np.array([400.0, 900.0]), np.array([150.0, 300.0]))
    assert not inside.any()
    assert outside.all()
    # One row and two take other kernels of the BLAS.
    np.testing.assert_allclose(beyond, [at_edge[0], at_edge[0]], rtol=1e-12)


def test_bins_are_of_equal_width_and_use_all_their_rows():
    """A soak of 1000 rows weighs no more than a passage of 4; what has too few rows is left out and counted."""
    celsius = np.concatenate([np.linspace(20.5, 21.5, 1001), [23.1, 23.2, 23.3, 23.3], [24.7]])
    reference = np.full(celsius.size, 10.0)
    found = binned(celsius * 2.0, celsius, reference, bin_degc=2.0, samples=4)
    np.testing.assert_allclose(found.temperature, [21.0, 23.225])
    assert found.left_out == 1
    np.testing.assert_allclose(found.raw, 2.0 * found.temperature)


def test_the_surface_takes_the_units_error_away():
    """The second paper's claim, on its range of -55 to 125 degC: at least an order of magnitude."""
    raw, celsius, rate = experiment(noise=1e-4)
    found = fit_surface(binned(raw, celsius, rate))
    before, after = np.abs(raw - rate).max(), np.abs(found.predict(raw, celsius)[0] - rate)
    assert np.sqrt(np.mean(after**2)) < 2e-4
    assert before > 1000 * np.sqrt(np.mean(after**2))


def flat(**changes):
    raw, celsius, rate = experiment()
    given = {"raw": raw, "temperature": celsius, "reference": rate, **changes}
    return lambda: fit_surface(Points(given["raw"], given["temperature"], given["reference"]))


@pytest.mark.parametrize(
    ("attempt", "why"),
    [
        (flat(reference=np.where(experiment()[2] > 0, 100.0, -100.0)), "points at 2 rates"),
        (flat(temperature=np.full(experiment()[0].size, 25.0)), "moves by 0 degC"),
        (flat(temperature=np.where(experiment()[1] > 25, 40.0, 20.0)), "too few different temperatures"),
        (lambda: binned(np.array([np.nan]), np.array([1.0]), np.array([1.0])), "no row"),
        (lambda: binned(np.array([1.0]), np.array([1.0]), np.array([1.0])), "no bin"),
    ],
)
def test_data_that_do_not_determine_a_surface_are_refused(attempt, why):
    with pytest.raises(InputError, match=why):
        attempt()


def test_a_run_without_a_table_has_no_surface():
    from tests.support.analysis_data import thermal_cycle

    with pytest.raises(InputError, match="applied_rate"):
        points_of(thermal_cycle(60.0))


def turned():
    """The experiment as a record, with a clock."""
    from bench.base.channels import DPH_PER_DPS
    from bench.record.dataset import Dataset

    raw, celsius, rate = experiment(noise=1e-4)
    time = 30.0 * np.arange(raw.size)
    channels = {"rate": raw * DPH_PER_DPS, "temperature": celsius, "applied_rate": rate}
    return Dataset("turned", time, channels, np.zeros(raw.size, dtype=np.int64), (), 30.0)


def test_the_model_of_the_paper_is_the_surface_of_the_paper():
    """`rows: bins` of a surface over the output: NR - B is Rate(NR, T), coefficient by coefficient."""
    from bench.analysis.effects.model import load_model
    from bench.analysis.fit.fitting import fit_model

    record = turned()
    found, wanted = fit_model(load_model("rate_surface"), record), fit_surface(points_of(record))
    assert found.rows == points_of(record).raw.size < len(record)
    units = np.array([3600.0 ** (i - 1) for i, _ in wanted.powers])
    own = -np.array([c.value for c in found.coefficients]) * units
    own[1] += 1.0
    np.testing.assert_allclose(own, wanted.coefficients, rtol=1e-5)
    assert found.rms_dph == pytest.approx(3600.0 * wanted.rms, rel=1e-9)


def test_bins_are_for_a_surface_or_a_spline_alone():
    from bench.analysis.effects.model import Model
    from bench.analysis.effects.registry import make
    from bench.analysis.fit.fitting import fit_model

    model = Model("mixed", (make("surface", {"over": "rate"}), make("thermal_lag")), "bins")
    with pytest.raises(InputError, match="rows: bins is for a surface or a spline alone, not for thermal_lag"):
        fit_model(model, turned())
