"""Every model of both papers and every figure of a certificate beside the same figure by code that is not ours.

    python -m benchmarks.independent            # a few seconds; prints the table of docs/uncertainty.md

Each row names the command that prints the figure, the figure, the independent figure and who computed it, and the
difference. The run is simulated by the truth of the hidden effects, which shares no equation with the models.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date

import allantools
import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.stats

from bench.analysis import allan_deviation, fit_model, fit_surface
from bench.analysis.effects.model import Model
from bench.analysis.effects.registry import make
from bench.analysis.fit.rate_surface import Points
from bench.base import FloatArray
from bench.deliver.certificate.propagation import Budget, Contribution
from bench.deliver.certificate.stated import Stated
from bench.record import Dataset, Orientation, earth_rate
from benchmarks.cases import recorded

KNOTS = 25


@dataclass(frozen=True)
class Row:
    """A figure, the same by other code, and what the two are."""

    what: str
    command: str
    ours: float
    theirs: float
    by: str

    @property
    def cells(self) -> tuple[str, ...]:
        """As the table prints it."""
        apart = abs(self.ours - self.theirs) / (abs(self.theirs) or 1.0)
        return self.what, f"`{self.command}`", f"{self.ours:.8g}", f"{self.theirs:.8g}", self.by, f"{apart:.1e}"


def run() -> Dataset:
    """A run over temperature with hysteresis-free truth and noise."""
    return recorded([], {"angle_random_walk": 0.01, "bias_instability": 0.03}, "ramp_-40_85", 1)


def rms(values: FloatArray) -> float:
    """Root of the mean square of the finite values."""
    return float(np.sqrt(np.nanmean(values**2)))


def ours(data: Dataset, effect: str, options: dict[str, object] | None = None) -> float:
    """RMS of the residuals of one effect [deg/h]."""
    return rms(fit_model(Model(effect, (make(effect, options),)), data, weights="count").residuals[0])


def least(columns: FloatArray, y: FloatArray) -> float:
    """RMS of the residuals of numpy's least squares."""
    return rms(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])


def spline_columns(x: FloatArray, ends: str) -> FloatArray:
    """Cubic B-splines (n, k) of scipy over equal intervals that meet the conditions at the ends: a null space."""
    knots = np.linspace(x.min(), x.max(), KNOTS)
    full = np.concatenate((knots[:1].repeat(3), knots, knots[-1:].repeat(3)))
    size = full.size - 4

    def at(points: FloatArray, order: int) -> FloatArray:
        splines = (scipy.interpolate.BSpline(full, np.eye(size)[i], 3) for i in range(size))
        return np.column_stack([spline.derivative(order)(points) if order else spline(points) for spline in splines])

    both, inner = knots[[0, -1]], np.array([knots[:2].mean(), knots[-2:].mean()])
    conditions = {
        "natural": lambda: at(both, 2),
        "parabolic": lambda: at(inner, 3),
        "periodic": lambda: np.vstack([np.diff(at(both, order), axis=0) for order in (1, 2)]),
        "free": lambda: np.zeros((0, size)),
    }[ends]()
    allowed = scipy.linalg.null_space(conditions) if len(conditions) else np.eye(size)
    return at(x, 0) @ allowed


def models(data: Dataset) -> Iterator[Row]:
    """RMS of each model beside that of numpy or scipy."""
    x, y, ones = data.channel("temperature"), data.bias, np.ones(len(data))
    theirs = rms(y - np.polynomial.Polynomial.fit(x, y, 3)(x))
    yield Row(
        "cubic, RMS [deg/h]",
        "bench compare --model polynomial",
        ours(data, "polynomial"),
        theirs,
        "numpy Polynomial.fit",
    )
    channels = [data.channel(name) for name in ("temperature", "frequency", "drive", "quadrature")]
    scaled = [(c - c.mean()) / c.std() for c in channels]
    columns = np.column_stack([ones, *(c**power for c in scaled for power in (1, 2, 3))])
    yield Row("regression, 13 coefficients, RMS [deg/h]", "bench compare --model regression",
              ours(data, "regression"), least(columns, y), "numpy lstsq")  # fmt: skip
    for ends in ("natural", "parabolic", "periodic", "free"):
        own = ours(data, "spline", {"intervals": KNOTS - 1, "ends": ends})
        yield Row(f"spline, 24 intervals, {ends} ends, RMS [deg/h]", "bench compare --model spline.yaml",
                  own, least(spline_columns(x, ends), y), "scipy BSpline, null space of the conditions")  # fmt: skip


def surface() -> Row:
    """The 21 coefficients of the second paper: RMS of the fit [deg/s] by numpy's Chebyshev polynomials."""
    rng = np.random.default_rng(1)
    rate, celsius = (grid.ravel() for grid in np.meshgrid(np.linspace(-150, 150, 13), np.linspace(-40, 85, 11)))
    raw = (
        rate * (1 + 6e-5 * (celsius - 25))
        + 1e-8 * rate**3
        + 1e-3
        + 1e-6 * celsius**2
        + 1e-5 * rng.normal(size=rate.size)
    )
    found = fit_surface(Points(raw, celsius, rate), 5)
    u, v = (2 * (c - c.min()) / np.ptp(c) - 1 for c in (raw, celsius))
    full = np.polynomial.chebyshev.chebvander2d(u, v, [5, 5])
    kept = [i * 6 + j for i in range(6) for j in range(6 - i)]
    return Row("rate surface, 21 coefficients, RMS [deg/s]", "bench report (rate table)", found.rms,
               least(full[:, kept], rate), "numpy chebvander2d, lstsq")  # fmt: skip


def noise() -> Iterator[Row]:
    """Allan deviation beside allantools."""
    rate = np.random.default_rng(1).normal(size=20_000) + np.cumsum(0.01 * np.random.default_rng(2).normal(size=20_000))
    curve = allan_deviation(rate, 1.0)
    for tau_s in (1.0, 32.0, 1024.0):
        at = int(np.argmin(np.abs(curve.tau_s - tau_s)))
        theirs = allantools.oadev(rate, rate=1.0, data_type="freq", taus=[curve.tau_s[at]])[1][0]
        yield Row(
            f"Allan deviation at {curve.tau_s[at]:g} s",
            "bench noise",
            float(curve.deviation_dph[at]),
            float(theirs),
            "allantools oadev",
        )


def budget() -> Iterator[Row]:
    """U of a budget with few degrees of freedom, drift and a second-order angle, by hand and by scipy's t."""
    table = Stated(value=10.0, unit="ppm", drift_per_year=2.0)
    drift = table.drifted(date(2025, 1, 1), date(2026, 1, 1))
    rate_dph = 130.0 * 3600.0
    parts = (
        Contribution("model", "A", "normal", 0.1, "deg/h", 1.0, 40.0, "x"),
        Contribution("turn-ons", "A", "normal", 2.0, "deg/h", 1.0, 4.0, "x"),
        Contribution("table", "B", "normal", table.standard, "ppm", 1e-6 * rate_dph, np.inf, "x"),
        Contribution("drift", "B", "rectangular", drift, "ppm", 1e-6 * rate_dph, np.inf, "x"),
    )
    total = Budget(parts, {})
    sizes = np.array([0.1, 2.0, 5.0 * 0.468, 2.0 / np.sqrt(3.0) * 0.468 * 365.0 / 365.25])
    u = float(np.sqrt(np.sum(sizes**2)))
    freedom = u**4 / (sizes[0] ** 4 / 40 + sizes[1] ** 4 / 4)
    theirs = float(scipy.stats.t.ppf(0.5 + 0.9545 / 2, freedom) * u)
    yield Row(
        "expanded uncertainty by the formula [deg/h]",
        "bench certificate",
        total.by_formula_dph,
        theirs,
        "Welch-Satterthwaite, scipy t",
    )
    drawn = np.random.default_rng(5)
    errors = 0.1 * drawn.standard_t(40, 10**6) + 2.0 * drawn.standard_t(4, 10**6) + sizes[2] * drawn.normal(size=10**6)
    errors += sizes[3] * np.sqrt(3.0) * drawn.uniform(-1, 1, 10**6)
    theirs = float(np.quantile(np.abs(errors), 0.9545))
    yield Row("the same by Monte Carlo [deg/h]", "bench certificate", total.monte_carlo[0], theirs, "numpy, 1e6 draws")


def earth() -> Row:
    """Earth rate along a level axis as the scalar product of two vectors in east, north, up."""
    latitude, azimuth = np.radians([48.1, 30.0])
    rotation = 360.0 / 23.9344696 * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    axis = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    stated = Orientation(latitude_deg=48.1, axis="level", azimuth_deg=30.0)
    own = float(earth_rate(stated, np.zeros(1))[0])
    return Row(
        "Earth rate along a level axis [deg/h]", "bench report", own, float(rotation @ axis), "vectors, sidereal day"
    )


def scale_factor() -> Iterator[Row]:
    """Temperature sensitivity of a scale factor, beside the truth that was put in."""
    t = np.arange(2400.0)
    celsius, rate = (
        22.5 + 60.0 * np.sin(t / 380.0),
        np.choose((t // 10 % 5).astype(int), [0.0, 60.0, -60.0, 130.0, -130.0]),
    )
    error = 5.0 + 0.1 * celsius + 3600e-6 * rate * (40.0 + 60.0 * (celsius - 25.0))
    error += 0.1 * np.random.default_rng(3).normal(size=t.size)
    channels = {"temperature": celsius, "applied_rate": rate, "rate": error + 3600.0 * rate}
    data = Dataset("table", 30.0 * t, channels, np.zeros(t.size, dtype=np.int64), (), 30.0)
    effects = (make("polynomial", {"order": 1}), make("scale_factor_temperature"))
    known = {c.key.split(".")[1]: c.value for c in fit_model(Model("sf", effects), data, weights="count").coefficients}
    yield Row("scale factor at 25 degC [ppm]", "bench report", known["s0"], 40.0, "simulated truth")
    yield Row("its temperature sensitivity [ppm/degC]", "bench report", known["s1"], 60.0, "simulated truth")


def rows() -> list[Row]:
    """All rows."""
    return [*models(run()), surface(), *noise(), *scale_factor(), *budget(), earth()]


def main() -> None:
    """Command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    head = ("figure", "command", "bench", "independent", "by", "relative difference")
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in rows():
        print("| " + " | ".join(row.cells) + " |")


if __name__ == "__main__":
    main()
