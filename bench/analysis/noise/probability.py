"""Probabilities of the normal and the chi-square distribution, as `scipy.stats` computes them.

That package takes a second to import; these are the functions of `scipy.special` behind it.
"""

from __future__ import annotations

from typing import Any

import scipy

CHI2_95 = 3.841458820694124
"""`chi2_quantile(0.95, 1)`; written out, so that nothing has to import `scipy.special` to be there."""


def chi2_quantile(share: float, freedom: Any) -> Any:
    """Value below which a chi-square variable of `freedom` degrees lies with this probability."""
    return 2 * scipy.special.gammaincinv(freedom / 2, share)


def chi2_tail(value: float, freedom: float) -> float:
    """Probability that a chi-square variable of `freedom` degrees exceeds a value."""
    return float(scipy.special.chdtrc(freedom, max(value, 0.0)))


def normal_share(value: float) -> float:
    """Probability that a standard normal variable is below a value."""
    return float(scipy.special.ndtr(value))
