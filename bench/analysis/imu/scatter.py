"""How rows of a triad scatter, estimated from what a model leaves: noise of the unit, and attitudes that are not exact.

Components of the covariance: white noise, flicker and random walk of the output (the shapes of `noise.whitening`), and
a small rotation of the attitude, drawn anew at each visit, or the same whenever an attitude is taken up, or that of a
table that leans. A rotation d adds d x u, so an axis sees the two inputs across it. Variances are those of restricted
maximum likelihood: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545; gradient as in S. R. Searle et al., Variance
Components (1992).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    """Variances of the components by restricted maximum likelihood beside columns (n, p); `known` ones stay.

    A weak pull keeps shares that are zero from going to minus infinity.
    """
    likelihood = Likelihood(columns, y, parts, known or {})

    def value(shares: FloatArray) -> float:
        return likelihood.value(shares) + 0.5 * _PULL * float(np.sum((shares - _START) ** 2))

    def slope(shares: FloatArray) -> FloatArray:
        return np.asarray(likelihood.slope(shares) + _PULL * (shares - _START))

    def curvature(shares: FloatArray) -> FloatArray:
        return likelihood.curvature(shares) + _PULL * np.eye(len(shares))

    best = minimized(value, slope, curvature, likelihood.size)
    return likelihood.scatter(best)


def minimized(
    value: Callable[[FloatArray], float],
    slope: Callable[[FloatArray], FloatArray],
    curvature: Callable[[FloatArray], FloatArray],
    size: int,
) -> FloatArray:
    """Logarithms (size,) of shares at which a function is least, from its derivatives."""
    best = minimize(
        value, np.full(size, _START), jac=slope, hess=curvature, method="trust-exact",
        options={"gtol": 0.02, "maxiter": 40, "initial_trust_radius": 2.0},
    )  # fmt: skip
    return np.asarray(best.x)


def _orthonormal(columns: FloatArray) -> FloatArray:
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])


class Likelihood:
    """Negative restricted log-likelihood over the logarithms (k,) of the unknown variances' shares.

    The second derivative is the average of observed and expected information (A. R. Gilmour, R. Thompson, B. R. Cullis,
    Biometrics 51 (1995) 1440).
    """

    def __init__(
        self, columns: FloatArray, y: FloatArray, parts: Mapping[str, FloatArray], known: Mapping[str, float]
    ) -> None:
        """Of data y (n,) beside columns (n, p).

        `parts` are unit covariances (n, n), `known` the variances that stay.
        """
        self._known = {name: variance for name, variance in known.items() if name in parts}
        self._fixed = sum((v * parts[name] for name, v in self._known.items()), np.zeros((len(y), len(y))))
        self._kernels = {name: part for name, part in parts.items() if name not in self._known}
        self._basis, self._y = _orthonormal(columns), y
        left = y - self._basis @ (self._basis.T @ y)
        level = float(left @ left) / max(1, len(y) - self._basis.shape[1]) or 1e-30
        self._units = np.array([level / max(float(np.mean(np.diag(k))), 1e-300) for k in self._kernels.values()])
        self._at: FloatArray | None = None
        self._found = np.empty(0), np.empty((0, 0))

    @property
    def size(self) -> int:
        """Number of unknown variances."""
        return len(self._kernels)

    def value(self, shares: FloatArray) -> float:
        """The function."""
        root = self._root(self._weights(shares))
        basis = solve_triangular(root, self._basis, lower=True, check_finite=False)
        y = solve_triangular(root, self._y, lower=True, check_finite=False)
        inner = cholesky(basis.T @ basis, lower=True, check_finite=False)
        along = solve_triangular(inner, basis.T @ y, lower=True, check_finite=False)
        return float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))) + 0.5 * (y @ y - along @ along))

    def slope(self, shares: FloatArray) -> FloatArray:
        """Its first derivative (k,)."""
        return self._evaluated(shares)[0]

    def curvature(self, shares: FloatArray) -> FloatArray:
        """Its second derivative (k, k), about."""
        return self._evaluated(shares)[1]

    def scatter(self, shares: FloatArray) -> Scatter:
        """The variances and their covariance."""
        weights = self._weights(shares)
        own = dict(zip(self._kernels, weights.tolist(), strict=True))
        return Scatter({**own, **self._known}, self._root(weights))

    def _weights(self, shares: FloatArray) -> FloatArray:
        return np.asarray(np.exp(np.clip(shares, _LEAST, _MOST)) * self._units)

    def _root(self, weights: FloatArray) -> FloatArray:
        total = self._fixed.copy()
        for weight, kernel in zip(weights, self._kernels.values(), strict=True):
            total += weight * kernel
        return np.asarray(cholesky(total, lower=True, check_finite=False, overwrite_a=True))

    def _evaluated(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._at is None or not np.array_equal(self._at, shares):
            self._at, self._found = shares.copy(), self._evaluate(self._weights(shares))
        return self._found

    def _evaluate(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        basis, y = self._basis, self._y
        root = self._root(weights)
        inverse = dpotri(root, lower=1)[0]
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        spread = inverse @ basis
        inner = cholesky(basis.T @ spread, lower=True, check_finite=False)
        projected = inverse - spread @ cho_solve((inner, True), spread.T, check_finite=False)
        pulled = projected @ y
        kernels = list(zip(weights, self._kernels.values(), strict=True))
        seen = np.stack([w * (k @ pulled) for w, k in kernels], axis=1)
        slope = 0.5 * (np.array([w * float(np.vdot(projected, k)) for w, k in kernels]) - pulled @ seen)
        return slope, 0.5 * seen.T @ projected @ seen + np.diag(np.maximum(slope, 0.0))
