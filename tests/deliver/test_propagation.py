"""The propagation of uncertainty against hand formulas, quantiles of another library, and sums of drawn errors."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest
from scipy import stats

from bench.analysis.judging.quantity import Quantity
from bench.base.errors import InputError
from bench.deliver.certificate.budget import _earth_per_degree
from bench.deliver.certificate.combined import with_table
from bench.deliver.certificate.laboratory import Instrument, load_instruments
from bench.deliver.certificate.propagation import Budget, Contribution
from bench.deliver.certificate.stated import Stated
from bench.record import EARTH_DPH, Orientation

pytest.importorskip("GTC")


def part(standard, distribution="normal", dof=np.inf, sensitivity=1.0, **more):
    return Contribution("x", "B", distribution, standard, "ppm", sensitivity, dof, "test", **more)


def test_effective_degrees_of_freedom_and_k_are_those_of_the_gum():
    """JCGM 100, G.4.1, written out by hand."""
    budget = Budget((part(0.25, dof=4.0), part(0.57, dof=5.0, sensitivity=-1.0), part(0.15, dof=15.0)), {})
    u = np.sqrt(0.25**2 + 0.57**2 + 0.15**2)
    dof = u**4 / (0.25**4 / 4 + 0.57**4 / 5 + 0.15**4 / 15)
    assert budget.combined_dph == pytest.approx(u)
    assert budget.effective_degrees_of_freedom == pytest.approx(dof)
    assert budget.by_formula_dph / u == pytest.approx(stats.t.ppf(0.97725, dof), rel=1e-4)
    assert Budget((part(1.0),), {}).coverage_factor == pytest.approx(2.0, rel=1e-4)


def test_errors_that_go_together_add_and_opposed_ones_cancel():
    parts = (part(3.0, label="a"), part(4.0, label="b"))
    assert Budget(parts, {("a", "b"): 1.0}).combined_dph == pytest.approx(7.0)
    assert Budget(parts, {("a", "b"): -1.0}).combined_dph == pytest.approx(1.0)
    opposed = (parts[0], part(4.0, label="b", sensitivity=-1.0))
    assert Budget(opposed, {("a", "b"): 1.0}).combined_dph == pytest.approx(1.0)
    half = Budget(parts, {("a", "b"): 0.5})
    assert half.combined_dph == pytest.approx(np.sqrt(9 + 16 + 12))
    assert half.monte_carlo[0] == pytest.approx(2 * half.combined_dph, rel=0.02)


@pytest.mark.parametrize("distribution", ["rectangular", "triangular", "arcsine", "normal"])
def test_monte_carlo_draws_what_the_distribution_says(distribution):
    drawn = part(2.0, distribution, sensitivity=0.5).draw(np.random.default_rng(1), 200_000)
    assert drawn.std() == pytest.approx(1.0, rel=0.01)
    assert drawn.mean() == pytest.approx(0.0, abs=0.01)


def test_monte_carlo_beside_the_formula():
    """Many equal sources: both agree. One rectangular source: its half-width bounds the error, k = 2 is too much."""
    many = Budget(tuple(part(0.1, "rectangular") for _ in range(20)), {})
    assert many.monte_carlo[0] == pytest.approx(many.by_formula_dph, rel=0.02)
    single = Budget((part(1.0, "rectangular"),), {})
    assert single.monte_carlo[0] == pytest.approx(np.sqrt(3.0) * 0.9545, rel=0.01)
    assert single.expanded_dph == pytest.approx(single.monte_carlo[0])
    few = Budget((part(1.0, dof=3.0),), {})
    assert few.monte_carlo[0] == pytest.approx(stats.t.ppf(0.97725, 3), rel=0.03)


def test_an_angle_acts_in_second_order():
    angle = part(0.5, sensitivity=10.0, power=2)
    drawn = angle.draw(np.random.default_rng(1), 400_000)
    assert angle.standard_dph == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=0.02)


def test_without_a_stated_uncertainty_there_is_no_u():
    budget = Budget((part(1.0), part(np.nan)), {})
    assert budget.unknown == ("x",)
    assert budget.figures()["expanded_dph"] is None
    assert Budget((part(1.0), part(np.nan, sensitivity=0.0)), {}).unknown == ()


def test_drift_grows_from_the_day_of_the_calibration():
    stated = Stated(value=0.2, unit="degC", k=2, drift_per_year=0.3)
    assert stated.standard == pytest.approx(0.1)
    assert stated.drifted(date(2026, 1, 1), date(2028, 1, 1)) == pytest.approx(0.6 / np.sqrt(3), rel=2e-3)
    assert stated.drifted(None, date(2028, 1, 1)) == pytest.approx(0.3 / np.sqrt(3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("uncertainty: [{value: 1, unit: furlong}]", "unit"),
        ("uncertainty: [{value: -1, unit: ppm}]", "value"),
        ("uncertainty: [{value: 1, unit: ppm}, {value: 2, unit: ppm}]", "each unit may occur once"),
        ("uncertainty: [{value: 1, unit: ppm, degrees_of_freedom: 5}], correlated_with: [{serial: B, coefficient: 1}]",
         "leave out degrees_of_freedom"),
    ],
)  # fmt: skip
def test_an_uncertainty_that_makes_no_sense_is_refused_with_its_line(tmp_path, text, message):
    file = tmp_path / "equipment.yaml"
    file.write_text(f"equipment:\n  - {{name: rate table, serial: A, {text}}}\n")
    with pytest.raises(InputError, match=message):
        load_instruments(file)


def test_a_scale_factor_is_as_uncertain_as_the_rate_table():
    fit = Quantity("scale_factor_error_ppm", 40.0, 39.9, 40.1)
    table = Instrument(name="rate table", serial="R", uncertainty=(Stated(value=10, unit="ppm"),))
    clock = Instrument(name="time base", serial="T", uncertainty=(Stated(value=6, unit="ppm"),))
    found = with_table(fit, (table, clock), date(2026, 1, 1))
    assert found.high - found.value == pytest.approx(np.sqrt(10**2 + 6**2 + 0.1**2))
    unknown = with_table(fit, (clock,), date(2026, 1, 1))
    assert np.isnan(unknown.low)
    assert "the rate table states no uncertainty" in unknown.reason


def test_the_earth_rate_is_as_uncertain_as_the_direction_of_the_axis():
    """Level at 45 degrees: 0.1 degree is 0.019 deg/h for an east axis (with the tilt 0.026), second order for north."""
    east = Orientation(latitude_deg=45.0, axis="level", azimuth_deg=90.0)
    north = Orientation(latitude_deg=0.0, axis="level", azimuth_deg=0.0)
    assert 0.1 * _earth_per_degree(east) == pytest.approx(np.hypot(0.01856, 0.01856), rel=1e-3)
    assert _earth_per_degree(north) == pytest.approx(0.0, abs=1e-9)
    step = 1e-4
    up = [EARTH_DPH * np.sin(np.radians(45.0 + d)) for d in (0.0, step)]
    vertical = Orientation(latitude_deg=45.0, axis="vertical")
    assert _earth_per_degree(vertical) == pytest.approx((up[1] - up[0]) / step, rel=1e-4)
    assert _earth_per_degree(None) == 0.0


def test_where_one_turn_on_dominates_u_is_what_monte_carlo_finds():
    """Welch and Satterthwaite are known to fail there: their k is that of a few degrees of freedom too many."""
    budget = Budget((part(0.1, dof=300.0), part(0.08, dof=1.0)), {})
    rng = np.random.default_rng(7)
    errors = np.abs(0.1 * rng.standard_t(300, 10**6) + 0.08 * rng.standard_t(1, 10**6))
    assert budget.expanded_dph > 1.3 * budget.by_formula_dph
    assert np.mean(errors <= budget.expanded_dph) == pytest.approx(0.9545, abs=0.003)
