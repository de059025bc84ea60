"""Probabilities of the normal and the chi-square distribution, as `scipy.stats` computes them.

That package takes a second to import; these are the functions of `scipy.special` behind it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from bench.base import FloatArray

CHI2_95 = 3.841458820694124
"""`chi2_quantile(0.95, 1)`; written out, so that nothing has to import `scipy.special` to be there."""

JUMP_95 = 7.352
"""The same for the place of a jump, of which the likelihood falls on either side as a random walk does:
-2 ln(1 - sqrt(0.95)). Source: B. E. Hansen, Econometrica 68 (2000) 575."""

_TWO_DEVIATIONS = 0.9545
"""How often one normal variable stays within two standard deviations."""


def chi2_quantile(share: float, freedom: Any) -> Any:
    """Value below which a chi-square variable of `freedom` degrees lies with this probability."""
    return 2 * scipy.special.gammaincinv(freedom / 2, share)


def sized(values: FloatArray, covariance: FloatArray) -> float:
    """Square of the distance of values (k,) from zero in terms of their covariance (k, k), over the square that chance
    stays below as often as one value stays within two deviations. Above 1 something of them is known, such as the
    size of a sine whose phase is not.
    """
    if not len(values):
        return 0.0
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    at = values * scale
    inverse = np.linalg.pinv(covariance * scale[:, None] * scale, rcond=1e-13, hermitian=True)
    return float(at @ inverse @ at) / float(chi2_quantile(_TWO_DEVIATIONS, len(values)))


def chi2_tail(value: float, freedom: float) -> float:
    """Probability that a chi-square variable of `freedom` degrees exceeds a value."""
    return float(scipy.special.chdtrc(freedom, max(value, 0.0)))


def normal_share(value: float) -> float:
    """Probability that a standard normal variable is below a value."""
    return float(scipy.special.ndtr(value))
