"""The signals that guards watch, from the newest reading of the chamber, its link and the units."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from bench.acquisition.profile.guards import Signal
from bench.acquisition.run.plausible import Plausible
from bench.acquisition.run.wiring import Surroundings
from bench.acquisition.station.links import SAME_DEGC, ChamberLink
from drivers.chamber import ChamberReading

if TYPE_CHECKING:
    from bench.acquisition.station.station import Station

OFF_S = 10.0
"""A chamber that says that it is off for longer than this while the run is on was switched off by somebody."""


def told(reading: ChamberReading) -> Collection[str]:
    """The optional signals that this controller does deliver."""
    names = {name for name in ("power", "door", "sensor_break") if getattr(reading, name) is not None}
    return names | ({"frozen_s"} if "power" in names else set())


class Signals:
    """Collects them once a tick; a signal that is not known now is left out."""

    def __init__(
        self,
        station: Station,
        link: ChamberLink,
        surroundings: Surroundings = dict,
        plausible: Plausible | None = None,
    ) -> None:
        self._surroundings, self._plausible = surroundings, plausible
        self._station, self._clock, self._link = station, station.clock, link
        self._reading: ChamberReading | None = None
        self._changed_s = 0.0
        self._off_since: float | None = None

    def take(self, reading: ChamberReading, ours_on: bool) -> None:
        """Take in a reading; `ours_on`: the chamber was switched on by us."""
        before, self._reading = self._reading, reading
        still = before is not None and reading.temperature == before.temperature and reading.power
        self._changed_s = self._changed_s if still else reading.t_s
        if self._plausible is not None:
            self._plausible.take(reading, ours_on)
        if not ours_on or reading.on:
            self._off_since = None
        elif self._off_since is None:
            self._off_since = reading.t_s

    def collect(self) -> dict[str, Signal]:
        """All signals that are known now, by name."""
        now_s = self._clock.now()
        silent_s = self._link.link.silent_s(now_s)
        failed_s = self._station.bus_failed_s
        signals = {"chamber_silent_s": Signal(silent_s, now_s), "bus_failed_s": Signal(failed_s, now_s)}
        return {
            **signals,
            **self._station.instruments.latest,
            **self._of_units(now_s),
            **self._of_chamber(),
            **self._surroundings(),
        }

    def _of_chamber(self) -> dict[str, Signal]:
        reading = self._reading
        if reading is None:
            return {}
        t_s = reading.t_s
        signals = {
            "chamber_temperature": Signal(reading.temperature, t_s),
            "alarm": Signal(float(bool(reading.alarm)), t_s, "; ".join(reading.alarm)),
        }
        foreign = self._foreign(reading)
        signals["override"] = Signal(float(bool(foreign)), t_s, "; ".join(foreign))
        if reading.power is not None:
            signals["power"] = Signal(reading.power, t_s)
            text = f"{reading.temperature:g} degC at {reading.power:.3g} %"
            signals["frozen_s"] = Signal(t_s - self._changed_s, t_s, text)
        for name in ("door", "sensor_break"):
            if (state := getattr(reading, name)) is not None:
                signals[name] = Signal(float(state), t_s)
        return signals

    def _foreign(self, reading: ChamberReading) -> list[str]:
        """What the chamber does that we did not command: two masters, or a power cut."""
        ours, found = self._station.chamber.commanded, list(self._link.deviations)
        if ours is not None and abs(reading.setpoint - ours) > SAME_DEGC:
            found.append(f"set point is {reading.setpoint:g} degC, the bench commanded {ours:g}")
        if self._off_since is not None and reading.t_s - self._off_since > OFF_S:
            found.append(f"the chamber has been off for {reading.t_s - self._off_since:.0f} s although the run is on")
        return found

    def _of_units(self, now_s: float) -> dict[str, Signal]:
        signals: dict[str, Signal] = {}
        units = self._station.units
        frames = [unit.newest_frame_s for unit in units if unit.newest_frame_s is not None]
        if frames and len(frames) == len(units):
            signals["frame_age"] = Signal(now_s - min(frames), now_s)
        signals["unit_doubted_s"] = Signal(max((unit.doubted_s for unit in units), default=0.0), now_s)
        air_now = None if self._reading is None else Signal(self._reading.temperature, self._reading.t_s)
        felt = [unit.temperature if unit.thermometer else air_now for unit in units]
        known = [signal for signal in felt if signal is not None]
        if known and len(known) == len(units):
            oldest_s = min(signal.t_s for signal in known)
            signals["unit_temperature"] = Signal(max(signal.value for signal in known), oldest_s)
            signals["unit_coldest"] = Signal(min(signal.value for signal in known), oldest_s)
            if self._reading is not None:
                air = self._reading.temperature
                apart = max(abs(signal.value - air) for signal in known)
                text = f"air {air:.2f} degC, unit sensors {', '.join(f'{s.value:.2f}' for s in known)} degC"
                signals["sensor_disagreement"] = Signal(apart, min(oldest_s, self._reading.t_s), text)
        if self._plausible is not None and self._reading is not None:
            complete = known if len(known) == len(units) else []
            signals |= self._plausible.signals(self._reading, complete)
        return signals
