"""What host time can say against a sample counter: frames that come before their sample, or stay behind for good."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]

SHIFT_NS = 50_000_000
"""Host stamps of a sound unit keep their least distance to its counter within this [ns]; drift is allowed for."""
DRIFT = 200e-6
"""More than the clocks of a unit and of a computer differ."""
PROOF_NS = 3_000_000_000
"""A counter that lies behind host time for this long [ns] after a gap has not stalled on its way: it started anew."""


@dataclass(frozen=True)
class Behind:
    """A counter that fell behind host time at `since_ns`, where its least delay before and since are known [ns]."""

    since_ns: int
    floor_ns: int
    least_ns: int

    def seen(self, delay: IntArray) -> Behind | None:
        """The same after further frames; None when one of them shows that it was a stall."""
        least = min(self.least_ns, int(delay.min()))
        return replace(self, least_ns=least) if least > self.floor_ns + SHIFT_NS else None


class Doubt:
    """Frames (n,) placed by their counters, held against host time: which of them cannot be where they claim."""

    def __init__(
        self,
        step: IntArray,
        steps: IntArray,
        t_ns: IntArray,
        delay: IntArray,
        past_ns: tuple[int, int],
        interval_ns: int,
    ) -> None:
        """`delay`: arrival less place of each frame [ns]; `past_ns`: that of the last one before, and the least."""
        last_ns, least_ns = past_ns
        self._delay, self._t_ns, self._interval_ns = delay, t_ns, interval_ns
        self._floor = np.minimum.accumulate(np.concatenate(([least_ns], delay[:-1])))
        self._slack = SHIFT_NS + DRIFT * np.abs(steps) * interval_ns
        self._gap = step > 1  # a counter that simply goes on is believed
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
        """Whether a frame with this place at `t_ns` would be early if row `at` were not there."""
        return bool(t_ns - place * self._interval_ns < self._floor[at] - self._slack[at])

    def moved(self) -> npt.NDArray[np.bool_]:
        """Frames from which on the counter lies behind host time and stays there."""
        moved = np.zeros(len(self._gap), dtype=bool)
        for at in self._fell.tolist():
            end = int(np.searchsorted(self._t_ns, self._t_ns[at] + PROOF_NS))
            if end < len(moved):
                moved[at] = self._delay[at:end].min() > self._floor[at] + SHIFT_NS
        return moved

    def unproven(self) -> Behind | None:
        """The last fall behind host time that the frames here are too few to judge."""
        for at in self._fell[-1:].tolist():
            if self._t_ns[-1] - self._t_ns[at] < PROOF_NS:
                return Behind(int(self._t_ns[at]), int(self._floor[at]), int(self._delay[at]))
        return None
