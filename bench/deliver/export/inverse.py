"""Effects over the table's rate as a surface over the unit's output, the only rate that a unit has in the field.

The output is R = W + B(W, T) + the other effects; solved for W at the nodes of a grid, B(W(R, T), T) is expanded in R
and T. The contribution of the others is taken as settled; a loop or a lag moves R by a few deg/h at most, times dB/dW
of some 1e-3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.base import DPH_PER_DPS, FloatArray, InputError
from bench.deliver.export import chebyshev
from bench.deliver.export.delivery import Delivery
from bench.deliver.export.exact import corrections

_ENOUGH_DPH = 1e-4


def static_over(
    delivery: Delivery, temperature: int, box: tuple[float, float], constant_dph: float
) -> Callable[[FloatArray], FloatArray]:
    """Contribution of the blocks so far over temperature [deg/h]: loops settled, other channels in mid-range."""

    def settled(degc: FloatArray) -> FloatArray:
        z = np.zeros((len(delivery.signals), degc.size))
        z[temperature] = chebyshev.to_unit(degc, box)
        return constant_dph + DPH_PER_DPS * corrections(delivery, z)

    return settled


def over_output(
    turning: chebyshev.Curve,
    settled: Callable[[FloatArray], FloatArray],
    output: tuple[float, float],
    temperature: tuple[float, float],
    most_order: int,
) -> tuple[int, FloatArray]:
    """Order and coefficients [deg/h] of the surface over the output [deg/h] and the temperature, within these boxes.

    `turning(W [deg/s], T)` is B [deg/h]. Raises InputError if B is so steep that R cannot be solved for W.
    """

    def value(output_dph: FloatArray, degc: FloatArray) -> FloatArray:
        free = output_dph - settled(degc)
        added = np.zeros(free.size)
        for _ in range(60):
            last, added = added, turning((free - added) / DPH_PER_DPS, degc)
            if np.abs(added - last).max() < 1e-9:
                return added
        raise InputError("the model's error over the rate is too large for a correction by the unit's output")

    a, b = np.meshgrid(np.linspace(*output, 41), np.linspace(*temperature, 41), indexing="ij")
    exact = value(a.ravel(), b.ravel())
    for order in range(1, most_order + 1):
        coefficients = chebyshev.surface(value, *output, *temperature, order)
        error = np.abs(
            chebyshev.evaluate_surface(
                coefficients, chebyshev.to_unit(a.ravel(), output), chebyshev.to_unit(b.ravel(), temperature)
            )
            - exact
        )
        if error.max() < _ENOUGH_DPH:
            break
    return order, coefficients
