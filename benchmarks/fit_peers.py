"""Alternatives to the one-pass fits, on the same samples, sorting included."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.fit_data import FOUR, INTERVALS, Data, Predict, clamped, ends, unit

PLANE = ("applied_rate", "temperature")


def scipy_spline(method: str) -> Callable[[Data], Predict]:
    def work(d: Data) -> Predict:
        from scipy.interpolate import make_lsq_spline

        order = np.argsort(d["temperature"])
        fitted = make_lsq_spline(d["temperature"][order], d["y"][order], clamped(d), 3, method=method)
        return lambda at: fitted(at["temperature"])

    return work


def scipy_univariate(d: Data) -> Predict:
    from scipy.interpolate import LSQUnivariateSpline

    x, first = np.unique(d["temperature"], return_index=True)
    fitted = LSQUnivariateSpline(x, d["y"][first], clamped(d)[4:-4])
    return lambda at: fitted(at["temperature"])


def powers_of(d: Data, bounds: list[tuple[float, float]]) -> np.ndarray:
    """13 columns, normalised, in the memory order of LAPACK."""
    out = np.empty((d["y"].size, 13), order="F")
    out[:, 0] = 1.0
    for k, (name, own) in enumerate(zip(FOUR, bounds, strict=True)):
        z = unit(d[name], *own)
        out[:, 3 * k + 1], out[:, 3 * k + 2], out[:, 3 * k + 3] = z, z * z, z * z * z
    return out


def plane_of(d: Data, bounds: list[tuple[float, float]]) -> np.ndarray:
    """21 columns, normalised."""
    x, z = (unit(d[name], *own) for name, own in zip(("applied_rate", "temperature"), bounds, strict=True))
    a, b = [np.ones_like(x)], [np.ones_like(z)]
    for _ in range(5):
        a.append(a[-1] * x)
        b.append(b[-1] * z)
    out = np.empty((x.size, 21), order="F")
    for column, (i, j) in enumerate((total - j, j) for total in range(6) for j in range(total + 1)):
        np.multiply(a[i], b[j], out=out[:, column])
    return out


def gelsy(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy import linalg

    return linalg.lstsq(columns, y, lapack_driver="gelsy", check_finite=False, overwrite_a=True)[0]


def gelsy_rows(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Stacked columns, row by row in memory, with the default checks."""
    from scipy import linalg

    return linalg.lstsq(np.ascontiguousarray(columns), y, lapack_driver="gelsy")[0]


def normal_equations(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy import linalg

    return linalg.cho_solve(linalg.cho_factor(columns.T @ columns), columns.T @ y)


def numpy_lstsq(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(columns, y, rcond=None)[0]


def statsmodels_qr(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    import statsmodels.api as sm

    return np.asarray(sm.OLS(y, columns).fit(method="qr").params)


def dense(names: tuple[str, ...], build: Any, solver: Any) -> Callable[[Data], Predict]:
    def work(d: Data) -> Predict:
        bounds = [ends(d[name]) for name in names]
        beta = solver(build(d, bounds), d["y"])
        return lambda at: build(at, bounds) @ beta

    return work


def polyfit(d: Data) -> Predict:
    beta = np.polyfit(d["temperature"], d["y"], 3)
    return lambda at: np.polyval(beta, at["temperature"])


def polynomial_fit(d: Data) -> Predict:
    fitted = np.polynomial.Polynomial.fit(d["temperature"], d["y"], 3)
    return lambda at: fitted(at["temperature"])


def sklearn_spline(d: Data, sparse: bool) -> Predict:
    """Sparse columns are solved by iteration, to some digits only."""
    from sklearn.linear_model import LinearRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import SplineTransformer

    basis = SplineTransformer(n_knots=INTERVALS + 1, degree=3, knots="uniform", sparse_output=sparse)
    fitted = make_pipeline(basis, LinearRegression(fit_intercept=False)).fit(d["temperature"][:, None], d["y"])
    return lambda at: fitted.predict(at["temperature"][:, None])


def sklearn_linear(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    from sklearn.linear_model import LinearRegression

    return LinearRegression(fit_intercept=False).fit(columns, y).coef_


def pygam_spline(d: Data) -> Predict:
    """The same 27 B-splines; the least smoothing that is stable."""
    from pygam import LinearGAM, s

    fitted = LinearGAM(s(0, n_splines=INTERVALS + 3, lam=1e-6), fit_intercept=False)
    fitted.fit(d["temperature"][:, None], d["y"])
    return lambda at: fitted.predict(at["temperature"][:, None])


def pygam_smooth(d: Data) -> Predict:
    """Smoothing by GCV among its default eleven."""
    from pygam import LinearGAM, s

    fitted = LinearGAM(s(0, n_splines=2 * INTERVALS + 3))
    fitted.gridsearch(d["temperature"][:, None], d["y"], progress=False)
    return lambda at: fitted.predict(at["temperature"][:, None])


SMOOTHING = 0.18
"""Of a smoothing spline for these samples, as GCV chooses it, a sample [degC^3]."""


def csaps_smooth(d: Data) -> Predict:
    """A knot at every sample, the smoothing given: its automatic choice fails for such dense noise."""
    import csaps

    x, first = np.unique(d["temperature"], return_index=True)
    fitted = csaps.csaps(x, d["y"][first], smooth=1.0 / (1.0 + SMOOTHING * x.size))
    return lambda at: fitted(at["temperature"])


def scipy_smooth(d: Data) -> Predict:
    """A knot at every sample, the smoothing given."""
    from scipy.interpolate import make_smoothing_spline

    x, first = np.unique(d["temperature"], return_index=True)
    fitted = make_smoothing_spline(x, d["y"][first], lam=SMOOTHING * x.size)
    return lambda at: fitted(at["temperature"])


def memory_pass(d: Data) -> Predict:
    total = d["temperature"].sum() + d["y"].sum()
    return lambda at: np.full(at["y"].size, total)
