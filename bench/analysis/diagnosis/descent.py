"""The minimum of a function of a few parameters between 0 and 1, by damped Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from bench.base import FloatArray

_ITERATIONS = 20
_LONGEST = 0.3  # step, of a parameter's range
_WIDE, _FINE = 5e-3, 1e-4  # differences for slopes, of a parameter's range
_STUCK = 1e5  # damping at which no direction goes down


class Height(Protocol):
    """What a place has: the height that is lowered."""

    @property
    def height(self) -> float:
        """The value of the function."""


Place = TypeVar("Place", bound=Height)


def descend(
    seen: Callable[[FloatArray], Place],
    slopes: Callable[[FloatArray, FloatArray, Place], tuple[FloatArray, FloatArray]],
    at: FloatArray,
    least: float,
) -> tuple[FloatArray, float]:
    """Lowest parameters (p,) from a start `at`, and the height there; it ends where less than `least` is to be gained.

    `slopes` are the gradient (p,) and the Gauss-Newton matrix (p, p) by differences (p,). They are wide first, so that
    a flat spot does not end the search, and shrink with the steps (Levenberg, Quart. Appl. Math. 2, 164, 1944).
    """
    here, damping = seen(at), 1e-2
    differences = np.full(len(at), _WIDE)
    for _ in range(_ITERATIONS):
        found = _step(seen, slopes(at, differences, here), at, here, damping, least)
        if found is None:
            if differences.max() <= _FINE:
                break
            differences, damping = np.full(len(at), _FINE), 1e-2
            continue
        new, there, damping = found
        differences = np.clip(0.3 * np.abs(new - at), 0.1 * _FINE, differences.max())
        at, here = new, there
    return at, here.height


def _step(
    seen: Callable[[FloatArray], Place],
    slope: tuple[FloatArray, FloatArray],
    at: FloatArray,
    here: Place,
    damping: float,
    least: float,
) -> tuple[FloatArray, Place, float] | None:
    """The next place, lower than `here`, and the damping there; None where too little is to be gained."""
    gradient, matrix = slope
    free = ~(((at <= 0.0) & (gradient > 0.0)) | ((at >= 1.0) & (gradient < 0.0)))
    size = np.diag(matrix)[free]
    while free.any() and damping < _STUCK:
        damped = matrix[np.ix_(free, free)] + np.diag(damping * size + 1e-9 * max(float(size.max()), 1e-3))
        step = np.zeros(len(at))
        step[free] = -np.linalg.solve(damped, gradient[free])
        new = np.clip(at + np.clip(step, -_LONGEST, _LONGEST), 0.0, 1.0)
        step = new - at
        expected = -float(gradient @ step + 0.5 * step @ matrix @ step)
        if not expected >= least:  # nor where it is no number
            return None
        there = seen(new)
        if there.height < here.height:
            return new, there, max(damping / 5.0, 1e-6) if here.height - there.height > 0.5 * expected else damping
        damping = 8.0 * max(damping, 1e-3)
    return None
