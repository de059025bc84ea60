"""Expansions in Chebyshev polynomials on a box, exact for polynomials; and the order of a surface's coefficients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.base import FloatArray

Curve = Callable[..., FloatArray]


def nodes(count: int) -> FloatArray:
    """Chebyshev nodes (count,) in [-1, 1]."""
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def orders(n: int) -> list[tuple[int, int]]:
    """(i, j) of C0, C1, ...: by total degree, then falling power of the first input; 21 pairs at n = 5."""
    return [(total - j, j) for total in range(n + 1) for j in range(total + 1)]


def _transform(count: int, n: int) -> FloatArray:
    """Matrix (n + 1, count) from values at the nodes to coefficients c_0..c_n."""
    weights: FloatArray = np.array(
        2.0 / count * np.polynomial.chebyshev.chebvander(nodes(count), n).T, dtype=np.float64
    )
    weights[0] *= 0.5
    return weights


def series(value: Curve, low: float, high: float, n: int) -> FloatArray:
    """Coefficients (n + 1,) of a function of one input on [low, high]."""
    count = n + 1
    coefficients: FloatArray = _transform(count, n) @ value(_at(nodes(count), low, high))
    return coefficients


def surface(value: Curve, a_low: float, a_high: float, b_low: float, b_high: float, n: int) -> FloatArray:
    """Coefficients ((n + 1)(n + 2)/2,) of a function of two inputs, total degree n, in the order of `orders`."""
    count = n + 1
    a, b = np.meshgrid(_at(nodes(count), a_low, a_high), _at(nodes(count), b_low, b_high), indexing="ij")
    values = value(a.ravel(), b.ravel()).reshape(count, count)
    matrix = _transform(count, n) @ values @ _transform(count, n).T
    return np.array([matrix[i, j] for i, j in orders(n)])


def pieces(value: Curve, low: float, high: float, m: int) -> FloatArray:
    """Coefficients (4 m,) of a function that is cubic, or nearly, on each of m equal pieces of [low, high]."""
    edges = np.linspace(low, high, m + 1)
    inside = _at(nodes(4), edges[:-1, None], edges[1:, None])
    coefficients: FloatArray = value(inside.ravel()).reshape(m, 4) @ _transform(4, 3).T
    return coefficients.ravel()


def _at(z: FloatArray, low: Any, high: Any) -> FloatArray:
    placed: FloatArray = 0.5 * (low + high) + 0.5 * (high - low) * z
    return placed


def evaluate_surface(coefficients: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Surface (points,) at a and b in [-1, 1], coefficients in the order of `orders`."""
    n = round((8 * coefficients.size + 1) ** 0.5 - 3) // 2
    first, second = np.polynomial.chebyshev.chebvander(a, n), np.polynomial.chebyshev.chebvander(b, n)
    return np.array(sum(c * first[:, i] * second[:, j] for c, (i, j) in zip(coefficients, orders(n), strict=True)))


def polynomial(coefficients: FloatArray, a_box: tuple[float, float], b_box: tuple[float, float]) -> Curve:
    """The surface as a function of both inputs in their units, continued outside the boxes."""

    def value(a: FloatArray, b: FloatArray) -> FloatArray:
        return evaluate_surface(coefficients, to_unit(a, a_box), to_unit(b, b_box))

    return value


def to_unit(values: FloatArray, box: tuple[float, float]) -> FloatArray:
    """Values mapped from a box to [-1, 1]."""
    return (values - 0.5 * (box[0] + box[1])) / (0.5 * (box[1] - box[0]))
