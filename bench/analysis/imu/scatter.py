"""How rows of a triad scatter, estimated from what a model leaves: noise of the unit, and attitudes that are not exact.

Components of the covariance: white noise, flicker and random walk of the output (the shapes of `noise.whitening`), and
a small rotation of the attitude, drawn anew at each visit, or the same whenever an attitude is taken up, or that of a
table that leans. A rotation d adds d x u, so an axis sees the two inputs across it. Variances are those of restricted
maximum likelihood: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545; gradient as in S. R. Searle et al., Variance
Components (1992).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from bench.analysis.imu.triad import Triad
from bench.analysis.noise.whitening import Ratios, covariance
from bench.base import FloatArray

_START, _LEAST, _MOST = np.log(0.3), np.log(1e-9), np.log(1e3)
"""Logarithms of a component's share of the mean variance of the residual: first tried, least, most."""
_PULL = 1e-3
ATTITUDES = ("visit", "attitude")
"""Components that are errors of the attitude, the same for all axes."""


def components(data: Triad, axis: int) -> dict[str, FloatArray]:
    """Unit covariances (n, n) by name; variances of `white` are [unit^2], of attitudes [rad^2]."""
    n, none = len(data.time), np.zeros(len(data.time))
    across = np.delete(data.driving, axis, axis=1)
    turned = across @ across.T
    found = {
        "white": np.eye(n),
        "flicker": covariance(data.time, data.interval_s, Ratios(1.0, 0.0), none),
        "walk": covariance(data.time, data.interval_s, Ratios(0.0, 1.0), none),
        "visit": turned * (data.visit[:, None] == data.visit[None, :]),
    }
    if data.kind == "accelerometer":
        # A table that stands leans by its wobble, the same in every attitude; while it turns this averages out.
        level = np.where(data.stay.stands[:, None], data.stay.attitude[:, axis, :2], 0.0)
        found["lean"] = float(np.mean(data.force**2)) * 3.0 * (level @ level.T)
    if len(np.unique(data.visit)) > len(np.unique(data.attitude)) > 1:
        found["attitude"] = turned * (data.attitude[:, None] == data.attitude[None, :])
    return found


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variances found and the covariance (n, n) that they make."""

    variances: Mapping[str, float]
    root: FloatArray
    """Lower Cholesky factor of the covariance."""
    log_likelihood: float
    """Of the data under the restricted likelihood."""

    def whiten(self, values: FloatArray) -> FloatArray:
        """Values (n,) or columns (n, k) with unit covariance."""
        return np.asarray(solve_triangular(self.root, values, lower=True, check_finite=False))


@dataclass(frozen=True, eq=False)
class Gls:
    """Generalised least squares: coefficients (p,), covariance (p, p), whitened residual (n,)."""

    beta: FloatArray
    covariance: FloatArray
    residual: FloatArray
    log_likelihood: float
    """Full (not restricted) Gaussian log-likelihood; compares models with different columns."""


def gls(columns: FloatArray, y: FloatArray, scatter: Scatter) -> Gls:
    """Fit y (n,) by columns (n, p); directions that rows do not determine get the shortest solution."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    white, target = scatter.whiten(columns / size), scatter.whiten(y)
    u, s, vt = np.linalg.svd(white, full_matrices=False)
    keep = s > 1e-10 * s[0]
    half = (vt[keep].T / s[keep]) / size[:, None]
    residual = target - u[:, keep] @ (u[:, keep].T @ target)
    log_det = 2.0 * float(np.sum(np.log(np.diag(scatter.root))))
    likelihood = -0.5 * (log_det + float(residual @ residual) + len(y) * np.log(2.0 * np.pi))
    return Gls(half @ (u[:, keep].T @ target), half @ half.T, residual, likelihood)


def estimate(
    columns: FloatArray, y: FloatArray, parts: Mapping[str, FloatArray], known: Mapping[str, float] | None = None
) -> Scatter:
    """Variances of the components by restricted maximum likelihood beside columns (n, p); `known` ones stay."""
    known = {name: variance for name, variance in (known or {}).items() if name in parts}
    fixed = sum((variance * parts[name] for name, variance in known.items()), np.zeros((len(y), len(y))))
    parts = {name: part for name, part in parts.items() if name not in known}
    basis = _orthonormal(columns)
    left = y - basis @ (basis.T @ y)
    level = float(left @ left) / max(1, len(y) - basis.shape[1])
    level = level if level > 0.0 else 1e-30
    kernels = list(parts.values())
    units = np.array([level / max(float(np.mean(np.diag(kernel))), 1e-300) for kernel in kernels])
    likelihood = _Restricted(kernels, fixed, units, basis, y)
    best = minimize(
        likelihood.value, np.full(len(kernels), _START), jac=likelihood.slope, hess=likelihood.curvature,
        method="trust-exact", options={"gtol": 0.02, "maxiter": 40, "initial_trust_radius": 2.0},
    )  # fmt: skip
    weights = np.exp(best.x) * units
    root = cholesky(_sum(weights, kernels, fixed), lower=True, check_finite=False)
    return Scatter({**dict(zip(parts, weights.tolist(), strict=True)), **known}, root, -float(best.fun))


def _sum(weights: FloatArray, kernels: list[FloatArray], total: FloatArray) -> FloatArray:
    for weight, kernel in zip(weights, kernels, strict=True):
        total = total + weight * kernel
    return total


def _orthonormal(columns: FloatArray) -> FloatArray:
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])


class _Restricted:
    """Negative restricted log-likelihood over the logarithms of the variances' shares.

    The second derivative is the average of observed and expected information (A. R. Gilmour, R. Thompson, B. R. Cullis,
    Biometrics 51 (1995) 1440). A weak pull keeps shares that are zero from going to minus infinity.
    """

    def __init__(
        self, kernels: list[FloatArray], fixed: FloatArray, units: FloatArray, basis: FloatArray, y: FloatArray
    ) -> None:
        self._kernels, self._fixed, self._units, self._basis, self._y = kernels, fixed, units, basis, y
        self._at: FloatArray | None = None
        self._found: tuple[float, FloatArray, FloatArray] = 0.0, np.empty(0), np.empty((0, 0))

    def value(self, shares: FloatArray) -> float:
        """The function."""
        return self._evaluated(shares)[0]

    def slope(self, shares: FloatArray) -> FloatArray:
        """Its first derivative."""
        return self._evaluated(shares)[1]

    def curvature(self, shares: FloatArray) -> FloatArray:
        """Its second derivative, about."""
        return self._evaluated(shares)[2]

    def _evaluated(self, shares: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        if self._at is None or not np.array_equal(self._at, shares):
            self._at, self._found = shares.copy(), self._evaluate(np.clip(shares, _LEAST, _MOST))
        value, slope, curvature = self._found
        off = shares - _START
        return value + 0.5 * _PULL * float(off @ off), slope + _PULL * off, curvature + _PULL * np.eye(len(off))

    def _evaluate(self, shares: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        weights, basis, y = np.exp(shares) * self._units, self._basis, self._y
        root = cholesky(_sum(weights, self._kernels, self._fixed), lower=True, check_finite=False)
        inverse = dpotri(root, lower=1)[0]
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        spread = inverse @ basis
        inner = cholesky(basis.T @ spread, lower=True, check_finite=False)
        projected = inverse - spread @ cho_solve((inner, True), spread.T, check_finite=False)
        pulled = projected @ y
        value = float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))) + 0.5 * y @ pulled)
        seen = np.stack([w * (k @ pulled) for w, k in zip(weights, self._kernels, strict=True)], axis=1)
        traces = [w * float(np.vdot(projected, k)) for w, k in zip(weights, self._kernels, strict=True)]
        slope = 0.5 * (np.array(traces) - pulled @ seen)
        return value, slope, 0.5 * seen.T @ projected @ seen + np.diag(np.maximum(slope, 0.0))
