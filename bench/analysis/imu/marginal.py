"""What coefficients are uncertain by where the variances of the noise are uncertain too: an average over variances.

Few rows say little about slow noise, and restricted maximum likelihood then often puts it at zero. So the coefficients'
errors are averaged over the posterior of the variances, each standard deviation with a half-Cauchy prior as wide as the
residual (A. Gelman, Bayesian Analysis 1 (2006) 515). The average is importance sampling from a t distribution about the
mode, which is adapted once (J. Geweke, Econometrica 57 (1989) 1317; M.-S. Oh, J. O. Berger, J. Stat. Comput. Simul. 41
(1992) 143).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import expit
from scipy.stats import qmc, t

from bench.analysis.imu.scatter import Likelihood, gls, minimized
from bench.base import FloatArray

_SAMPLES = 32
_FREEDOM = 5.0


def marginal_covariance(
    columns: FloatArray, y: FloatArray, parts: Mapping[str, FloatArray], known: Mapping[str, float], beta: FloatArray
) -> FloatArray:
    """Mean square (p, p) of the errors of coefficients beta (p,) of columns (n, p) over the components' variances.

    `parts` are unit covariances (n, n); the variances in `known` stay.
    """
    likelihood = Likelihood(columns, y, parts, known)
    centre, spread = _mode(likelihood)
    for _ in range(2):
        shares, log_weight = _drawn(centre, spread, likelihood)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        centre = weight @ shares
        off = shares - centre
        spread = (weight[:, None] * off).T @ off + 1e-3 * np.eye(len(centre))
    total = np.zeros((columns.shape[1],) * 2)
    for share, part in zip(shares, weight, strict=True):
        if part > 1e-4:
            found = gls(columns, y, likelihood.scatter(share))
            apart = found.beta - beta
            total += part * (found.covariance + np.outer(apart, apart))
    return total


def _log_prior(shares: FloatArray) -> float:
    """Of the logarithms of variances whose roots have half-Cauchy priors of scale 1."""
    return float(np.sum(0.5 * shares - np.logaddexp(0.0, shares)))


def _mode(likelihood: Likelihood) -> tuple[FloatArray, FloatArray]:
    """Where the posterior of the logarithms (k,) is highest, and its spread (k, k) there."""

    def value(shares: FloatArray) -> float:
        return likelihood.value(shares) - _log_prior(shares)

    def slope(shares: FloatArray) -> FloatArray:
        return np.asarray(likelihood.slope(shares) - 0.5 + expit(shares))

    def curvature(shares: FloatArray) -> FloatArray:
        up = expit(shares)
        return np.asarray(likelihood.curvature(shares) + np.diag(up * (1.0 - up)))

    best = minimized(value, slope, curvature, likelihood.size)
    return best, np.asarray(np.linalg.inv(curvature(best)))


def _drawn(centre: FloatArray, spread: FloatArray, likelihood: Likelihood) -> tuple[FloatArray, FloatArray]:
    """Samples (m, k) of the logarithms of the shares, and their log weights (m,)."""
    uniform = qmc.Sobol(len(centre), rng=1).random(_SAMPLES)
    steps = t.ppf(uniform, _FREEDOM)
    shares = centre + steps @ np.linalg.cholesky(spread).T
    density = np.sum(t.logpdf(steps, _FREEDOM), axis=1)
    posterior = [_log_prior(share) - likelihood.value(share) for share in shares]
    return shares, np.array(posterior) - density
