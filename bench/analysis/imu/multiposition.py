"""Accelerometers from gravity's size alone: no attitude has to be known.

Equation: |C(T) (y - b(T))| = g at rest in every position, C lower triangular (scale factors and the three angles
between the axes); the rotation of the triad in its case cannot be seen. Every entry is a curve over temperature, all
fitted jointly. Source: D. Tedaldi, A. Pretto, E. Menegatti, ICRA 2014; I. Skog, P. Händel, XVII IMEKO (2006).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bench.analysis.imu.triad import Curve
from bench.base import FloatArray, InputError

_LARGEST = {True: 0.5, False: 0.02}
"""U of a bias [m/s^2] and of an entry above which it counts as not determined."""
_ENTRIES = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
NAMES = (
    "bias x", "bias y", "bias z", "scale factor x", "angle x-y", "scale factor y", "angle x-z", "angle y-z",
    "scale factor z",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class GravityFit:
    """Result of the method of many positions."""

    curve: Curve
    beta: FloatArray
    """(9, k): curves of the three biases [m/s^2] and the six entries of C less the unit matrix."""
    covariance: FloatArray
    """(9 k, 9 k)."""
    rms: float
    """Of the size of gravity [m/s^2]."""

    def values(self, temperature: float) -> dict[str, tuple[float, float]]:
        """Value and U (k = 2) by name: biases [m/s^2], entries of C less one [1].

        U is of the rows' scatter alone: how a bias wanders in hours, they do not show.
        """
        basis = self.curve.columns(np.array([temperature]))[0]
        k = self.curve.size
        return {
            name: (float(self.beta[i] @ basis),
                   2.0 * float(np.sqrt(basis @ self.covariance[i * k : i * k + k, i * k : i * k + k] @ basis)))
            for i, name in enumerate(NAMES)
        }  # fmt: skip


def fit_gravity(output: FloatArray, temperature: FloatArray, gravity: float, curve: Curve) -> GravityFit:
    """Fit means at rest (n, 3) [m/s^2] at temperatures (n,) [degC].

    InputError names what the positions do not determine.
    """
    curve = curve.over(float(temperature.min()), float(temperature.max()))
    basis, k = curve.columns(temperature), curve.size
    if len(output) <= 9 * k:
        raise InputError(f"{len(output)} rows for {9 * k} parameters; measure more positions or lower the order")

    def left(beta: FloatArray) -> FloatArray:
        values = basis @ beta.reshape(9, k).T
        return np.asarray(np.linalg.norm(_applied(output - values[:, :3], values[:, 3:]), axis=1) - gravity)

    found = least_squares(left, np.zeros(9 * k), x_scale=np.repeat([gravity] * 3 + [1.0] * 6, k), method="trf")
    variance = 2.0 * float(found.cost) / (len(output) - 9 * k)
    covariance = variance * _inverse(np.asarray(found.jac, dtype=np.float64))
    fit = GravityFit(curve, found.x.reshape(9, k), covariance, float(np.sqrt(np.mean(found.fun**2))))
    ends = (curve.low, curve.high)
    loose = [name for name in NAMES if max(fit.values(t)[name][1] for t in ends) > _LARGEST[name.startswith("bias")]]
    if loose:
        raise InputError(f"these positions do not determine {', '.join(loose)}; needs 9 and more, well spread")
    return fit


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Inverse of the normal equations; directions that the rows leave free get a variance beyond any limit."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    _, s, vt = np.linalg.svd(jacobian / size, full_matrices=False)
    half = vt.T / np.maximum(s, 1e-12 * s[0]) / size[:, None]
    return np.asarray(half @ half.T)


def _applied(vectors: FloatArray, entries: FloatArray) -> FloatArray:
    out = vectors.copy()
    for column, (i, j) in enumerate(_ENTRIES):
        out[:, i] += entries[:, column] * vectors[:, j]
    return out
