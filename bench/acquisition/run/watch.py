"""The watchdog of a run: started before anything is set or moves, told at every tick that the bench is alive."""

from __future__ import annotations

from contextlib import suppress

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.standstill import Standstill
from bench.acquisition.station.station import Station
from bench.acquisition.station.watchdog import Watchdog
from bench.base import EquipmentError
from drivers.clock import WallClock

INSTRUMENTS_S = 600.0
"""So long may instruments take to be set, together [s]; after that, the bench says every second that it is alive."""


class Watch:
    """A process of its own that watches over real equipment; a simulated chamber ends with this process."""

    def __init__(self, station: Station, recorder: Recorder) -> None:
        self._station, self._recorder = station, recorder
        self._watchdog: Watchdog | None = None
        self._standstill = Standstill(recorder.event)

    @property
    def over(self) -> bool:
        """Whether there is a watchdog."""
        return self._watchdog is not None

    def start(self) -> None:
        """Start it: from now on instruments are set. EquipmentError when it does not start."""
        clock = self._station.clock
        if not isinstance(clock, WallClock):
            return
        station, path = self._station, self._recorder.run.path
        self._watchdog = Watchdog(
            station.settings, path, clock.started_monotonic_ns, station.chamber.known, station.claim
        )
        self._watchdog.arm(instruments_only=True)
        self.allow(INSTRUMENTS_S)
        pid = self._watchdog.pid
        self._recorder.event("watchdog", f"process {pid} watches over this run", pid=pid)

    def arm(self) -> None:
        """From now on the chamber is commanded, too."""
        if self._watchdog is not None:
            self._watchdog.arm()

    def beat(self) -> None:
        """The bench is alive, and says when it stood still. EquipmentError when the watchdog is not."""
        if isinstance(self._station.clock, WallClock):
            self._standstill.tick(self._station.clock.now())
        if self._watchdog is not None:
            self._watchdog.beat()

    def allow(self, silent_s: float) -> None:
        """The bench may be silent for so long [s]; a watchdog that died does not keep it from being safe."""
        if self._watchdog is not None:
            with suppress(EquipmentError):
                self._watchdog.beat(silent_s)

    def end(self, verified: bool) -> None:
        """The equipment is verified to be safe, or the watchdog goes on trying without the bench."""
        if self._watchdog is not None:
            (self._watchdog.done if verified else self._watchdog.take_over)()
