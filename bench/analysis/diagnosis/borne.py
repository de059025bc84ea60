"""What check runs say of a model, as evidence: how much more probable they are with it than without.

The likelihood is that of the fitted runs: the error on the check runs, each beside a constant of its own, with the
noise profiled anew, isothermal records beside it. The coefficients are those of the fitted runs, so that nothing is
paid for them; what followed those runs by chance, or by a function of time that happened to fit, loses here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.analysis.diagnosis.proof import LeftOut, beside_states
from bench.analysis.noise.likelihood import NoiseLattice, Point, Record, Surface
from bench.base import BoolArray, FloatArray
from bench.record import Dataset


@dataclass(frozen=True, eq=False)
class Borne:
    """Judges models by check runs, with isothermal records; the search of the noise begins at `start`."""

    check: Sequence[Dataset]
    statics: Sequence[Record]
    start: Point
    _known: dict[bytes, NoiseLattice] = field(default_factory=dict, repr=False)
    _heights: dict[tuple[bytes, bytes], float] = field(default_factory=dict, repr=False)

    def gain(self, before: LeftOut, after: LeftOut) -> float:
        """Gain in 2 ln L of what `after` has beside `before`; 0 without check runs that both predict."""
        before = beside_states(before, after)
        if not self.check or before.residual is None or after.residual is None:
            return 0.0
        known = np.isfinite(before.residual) & np.isfinite(after.residual)
        if not known.any():
            return 0.0
        key = before.residual.tobytes(), known.tobytes()
        if key not in self._heights:  # one model is compared with many
            self._heights[key] = self._height(before.residual, known)
        return self._heights[key] - self._height(after.residual, known)

    def _height(self, residual: FloatArray, known: BoolArray) -> float:
        """-2 ln L of the errors (n,) of all check runs, where they are known."""
        ends = np.cumsum([len(run) for run in self.check])[:-1]
        parts = zip(self.check, np.split(residual, ends), np.split(known, ends), strict=True)
        errors = [Record(run.time[own], r[own], np.ones((int(own.sum()), 1))) for run, r, own in parts if own.any()]
        records = (*errors, *self.statics)
        key = known.tobytes()
        if key not in self._known:  # all models share the whiteners
            self._known[key] = NoiseLattice(records, self.check[0].interval_s)
        surface = Surface.of(records, self._known[key], restricted=True)
        surface.visit([self.start])
        return surface.height(surface.descend(self.start))
