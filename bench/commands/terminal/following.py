"""A live run followed by fits that are always up to date: shown by `bench status`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench import acquisition
from bench.analysis import SoFar

if TYPE_CHECKING:
    from collections.abc import Callable


class Following:
    """Onlooker of a run that fits the 1 s means of every unit as they come, and tells the desk on request.

    Not on a rate table: what it turns is no bias, and its readings come later than the samples.
    """

    def __init__(
        self,
        profile: acquisition.Profile,
        desk: acquisition.Desk,
        onlooker: Callable[[acquisition.Station, acquisition.Status], None],
        heard: Callable[[str, float, float, float], None] = lambda *_: None,
    ) -> None:
        """`heard` is told serial number, time, temperature and rate of every unit at every tick."""
        setpoints = profile.setpoint(np.linspace(0.0, profile.duration_s, 4096))
        self._range = float(np.min(setpoints)), float(np.max(setpoints))
        self._onlooker, self._heard = onlooker, heard
        self._units: dict[str, SoFar] = {}
        desk.notes = self.notes

    def __call__(self, station: acquisition.Station, status: acquisition.Status) -> None:
        """Take in a tick; the onlooker behind sees it too."""
        if station.turntable is None:
            for unit in station.units:
                if unit.temperature is not None:
                    so_far = self._units.setdefault(unit.serial, SoFar(*self._range))
                    mean = status.t_s, unit.temperature.value, unit.level.take()
                    so_far.add(*mean)
                    self._heard(unit.serial, *mean)
        self._onlooker(station, status)

    def notes(self) -> dict[str, Any]:
        """The fits so far by serial number."""
        found = {serial: so_far.report() for serial, so_far in list(self._units.items())}
        return {"fits": {serial: report for serial, report in found.items() if report is not None}}
