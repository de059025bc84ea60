"""Slow change of the bias with powered time.

Equation: B = k t, or with `law: logarithm` B = k ln(1 + t / t_0), or `law: both`; t from the start of the record.
Units: B [deg/h], t and t_0 [h] (`settled_h`, how long the unit had aged before), k [deg/h/h] or, of ln, [deg/h].
Source: IEEE 952 (rate ramp); charging and outgassing slow down as a logarithm; 0.01-0.1 deg/h a day are usual.
When left out: the residual climbs through the whole record; equal temperatures early and late differ.
Look-alikes: warm_up (ends), creep (follows the temperature), bias_jump (at once), random walk of the rate.
Separated by: the same temperature at start, middle and end; a static run of the same length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.base import Effect, Theta, check_choice, check_number
from bench.base import FloatArray
from bench.record import Dataset

LAWS = ("line", "logarithm", "both")


@dataclass(frozen=True)
class Aging(Effect):
    """One or two terms in time; `law` line, logarithm or both, `settled_h` above 0."""

    name = "aging"
    by_clock = True

    law: str = "line"
    settled_h: float = 1.0

    def __post_init__(self) -> None:
        check_choice(self.name, "law", self.law, LAWS)
        check_number(self.name, "settled_h", self.settled_h, 1e-3, 1e6)

    def shapes(self) -> tuple[Effect, ...]:
        """A line, or a change that slows down."""
        return (self, replace(self, law="logarithm")) if self.law == "line" else (self,)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Time [h], its logarithm, or both (n, 1 or 2)."""
        hours = record.time / 3600.0
        both = np.column_stack([hours, np.log1p(np.maximum(hours, 0.0) / self.settled_h)])
        return both[:, self._terms]

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """The k of each term."""
        both: tuple[tuple[str, str], ...] = (("line", "deg/h/h"), ("logarithm", "deg/h"))
        return both[self._terms]

    @property
    def _terms(self) -> slice:
        return {"line": slice(0, 1), "logarithm": slice(1, 2), "both": slice(0, 2)}[self.law]
