"""Simulated fixture with driven axes on the rate table: the attitude of the units follows from where its axes stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivers.sim.cia402_table import SimulatedTable

FloatArray = npt.NDArray[np.float64]

_MOVES_DPS = 0.02
_DIGITS = 3
"""Of the positions [deg]: the attitude is the same one each time, whatever the last count of an encoder."""


class SimulatedFixture:
    """Axes from the rate table to the units, moved by `advance`."""

    def __init__(self, axes: Sequence[SimulatedTable], directions: FloatArray, zero: FloatArray) -> None:
        """`directions` (n, 3): the axes in the table's frame; `zero` (3, 3): from it to the units, all axes at 0."""
        self.axes = tuple(axes)
        self._directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        self._zero = zero
        self._moves = False
        self.attitude, self.visit = zero, 0
        """From the table's frame to that of the units, (3, 3), and how often it has left an attitude."""

    def advance(self, t0_s: float, t1_s: float) -> None:
        """Move the axes from `t0_s` to `t1_s` [s]."""
        for axis in self.axes:
            axis.advance(t0_s, t1_s)
        moves = any(abs(axis.rate_dps) > _MOVES_DPS for axis in self.axes)
        self.visit += moves and not self._moves
        self._moves = moves
        from scipy.spatial.transform import Rotation  # 0.2 s of imports, which only a fixture needs

        turned = Rotation.identity()
        for axis, direction in zip(self.axes, self._directions, strict=True):
            turned = turned * Rotation.from_rotvec(np.radians(round(axis.angle_deg, _DIGITS)) * direction)
        self.attitude = self._zero @ turned.inv().as_matrix()

    def close(self) -> None:
        """Leave the buses; their owner closes them."""
        for axis in self.axes:
            axis.close()
