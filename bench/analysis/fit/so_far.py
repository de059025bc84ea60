"""How well simple models describe a live run: one mean is added every second, and the answer is ready at any time.

Only sums in cells of temperature are kept (`bench.analysis.fit.state`), so that an hour or a day costs the same: some
microseconds a tick, a millisecond an answer.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from bench.analysis.fit.cells import Cells
from bench.analysis.fit.normal import held_out_rms, penalised_rms
from bench.analysis.fit.smooth import roughness, spline_normal
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.fit.state import State
from bench.base import FloatArray, finite

MARGIN_DEGC = 20.0
"""A unit may be so much warmer or colder than its chamber's set points; what lies beyond is left out, and counted."""
CELLS = 24
_WAITING = 64
_TRACE = 1e-9
_LEAST = 60
"""Seconds before there is anything to say."""
_MODELS = (("polynomial", 1, "free"), ("spline", CELLS, "natural"))
"""A cubic is a spline of one interval."""


class SoFar:
    """Models of one unit's means so far; one thread adds, any thread asks."""

    def __init__(self, low_degc: float, high_degc: float) -> None:
        """Range of the set points [degC]."""
        self._low, self._high = low_degc - MARGIN_DEGC, high_degc + MARGIN_DEGC
        self._lock = threading.Lock()
        self._waiting: list[tuple[float, float, float]] = []
        self._state: State | None = None
        self._outside = 0
        self._visited = [np.inf, -np.inf]

    def add(self, t_s: float, temperature_degc: float, rate_dph: float) -> None:
        """Take in the mean of a second; NaN means that it has no value."""
        if not (np.isfinite(temperature_degc) and np.isfinite(rate_dph)):
            return
        with self._lock:
            if self._low <= temperature_degc <= self._high:
                self._waiting.append((t_s, temperature_degc, rate_dph))
            else:
                self._outside += 1
            if len(self._waiting) >= _WAITING:
                self._flush()

    def _flush(self) -> None:
        if not self._waiting:
            return
        time, temperature, rate = np.array(self._waiting).T.copy()
        self._waiting.clear()
        if self._state is None:
            self._state = State(Cells(self._low, self._high, CELLS, float(np.mean(rate))))
        self._visited = [min(self._visited[0], temperature.min()), max(self._visited[1], temperature.max())]
        self._state.add(time, {"temperature": temperature}, rate)

    def report(self) -> dict[str, Any] | None:
        """RMS [deg/h] of each model on the means so far, and on blocks of 200 s left out; None at the beginning."""
        with self._lock:
            self._flush()
            state = self._state
            if state is None or state.touched < _LEAST:
                return None
            cells, groups, seconds = state.sums, state.grouped(state.folds()), state.touched
        if not isinstance(cells, Cells):
            raise RuntimeError("so far is summed in cells")
        with one_blas_thread():
            models = [_scored(cells, groups, *model) for model in _MODELS]
        return {
            "seconds": seconds,
            "outside": self._outside,
            "from_degc": round(float(self._visited[0]), 2),
            "to_degc": round(float(self._visited[1]), 2),
            "models": models,
        }


def _scored(cells: Cells, sums: FloatArray, name: str, intervals: int, ends: str) -> dict[str, Any]:
    """A part of the range is not visited yet: there a trace of roughness decides, which elsewhere changes no digit."""
    groups, penalty = spline_normal(cells, sums, intervals, ends), roughness(cells, intervals, ends)
    penalty *= _TRACE * np.trace(groups.gram.sum(axis=0)) / np.trace(penalty)
    rms = penalised_rms(groups.sum(), penalty)
    held_out = held_out_rms(groups, penalty) if len(groups.right) > 1 else np.inf
    return {"name": name, "rms_dph": finite(rms, 4), "held_out_rms_dph": finite(held_out, 4)}
