"""Checks of a sample counter against host time: frames that arrive before their sample, or stay late permanently."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]

SHIFT_NS = 50_000_000
"""Largest change [ns] of the least delay between a unit's counter and host stamps, apart from drift."""
DRIFT = 200e-6
"""Upper bound on the relative drift between the clocks of a unit and of a computer."""
PROOF_NS = 3_000_000_000
"""A counter that lies behind host time for this long [ns] after a gap was reset; a stall would have caught up."""


@dataclass(frozen=True)
class Behind:
    """A counter that fell behind host time at `since_ns`: its least delay before (`floor_ns`) and since [ns]."""

    since_ns: int
    floor_ns: int
    least_ns: int

    def seen(self, delay: IntArray) -> Behind | None:
        """Updated with further frames; None when one of them shows that it was a stall."""
        least = min(self.least_ns, int(delay.min()))
        return replace(self, least_ns=least) if least > self.floor_ns + SHIFT_NS else None


class Doubt:
    """Frames (n,) placed by their counters and compared with host time: which places are impossible."""

    def __init__(
        self,
        step: IntArray,
        steps: IntArray,
        t_ns: IntArray,
        delay: IntArray,
        past_ns: tuple[int, int],
        interval_ns: int,
    ) -> None:
        """`delay`: arrival minus place of each frame [ns]; `past_ns`: delay of the last frame before, least delay."""
        last_ns, least_ns = past_ns
        self._delay, self._t_ns, self._interval_ns = delay, t_ns, interval_ns
        self._floor = np.minimum.accumulate(np.concatenate(([least_ns], delay[:-1])))
        self._slack = SHIFT_NS + DRIFT * np.abs(steps) * interval_ns
        self._gap = step > 1  # a counter without a gap is trusted
        fell = np.diff(delay, prepend=last_ns) > self._slack
        self._fell = np.flatnonzero(self._gap & fell & (delay > self._floor + self._slack))

    def place(self, at: int) -> int:
        """Sample index of a row."""
        return int(self._t_ns[at] - self._delay[at]) // self._interval_ns

    def early(self) -> npt.NDArray[np.bool_]:
        """Frames that arrived before their sample was taken."""
        result: npt.NDArray[np.bool_] = self._gap & (self._delay < self._floor - self._slack)
        return result

    def comes_early(self, at: int, t_ns: int, place: int) -> bool:
        """Whether a frame with this place at `t_ns` would be early without row `at`."""
        return bool(t_ns - place * self._interval_ns < self._floor[at] - self._slack[at])

    def moved(self) -> npt.NDArray[np.bool_]:
        """Frames from which on the counter permanently lies behind host time."""
        moved = np.zeros(len(self._gap), dtype=bool)
        for at in self._fell.tolist():
            end = int(np.searchsorted(self._t_ns, self._t_ns[at] + PROOF_NS))
            if end < len(moved):
                moved[at] = self._delay[at:end].min() > self._floor[at] + SHIFT_NS
        return moved

    def unproven(self) -> Behind | None:
        """The last fall behind host time that has too few frames after it to be judged."""
        for at in self._fell[-1:].tolist():
            if self._t_ns[-1] - self._t_ns[at] < PROOF_NS:
                return Behind(int(self._t_ns[at]), int(self._floor[at]), int(self._delay[at]))
        return None
