"""What a station is opened for, and what its simulated units remember of earlier occasions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.record import slug
from drivers.sim.sender import Frames


@dataclass(frozen=True)
class Occasion:
    """What a station is opened for; only a simulated one depends on more of it than its start."""

    name: str = ""
    """Of what is run: it makes the noise of a simulated station its own."""
    part: int = 1
    """Of a run whose bench was started more than once for it; each has noise of its own."""
    start_s: float = 0.0
    """Bench time at which it begins [s]; later than 0: the units have kept their power."""
    power_ons: Mapping[str, int] = field(default_factory=dict)
    """How often each unit was powered, by serial number: each power-on is a new draw of the turn-on bias."""

    switches_power: bool = False
    """Whether the supply of the units is needed."""
    senders: Mapping[str, Frames] = field(default_factory=dict)
    """What makes the frames of simulated units in the place of the simulator, by serial number."""

    @property
    def noise(self) -> str:
        """What the noise is named after."""
        return self.name if self.part == 1 else f"{self.name} {self.part}"


def power_ons_file(settings: StationSettings, unit: UnitSettings) -> Path | None:
    """File beside the folder of the memories that says how often a unit was powered; None: nobody remembers."""
    return None if settings.eeproms is None else Path(f"{settings.eeproms}.{slug(unit.serial)}.power_ons")


def eeprom_file(settings: StationSettings, unit: UnitSettings) -> Path | None:
    """File that is the calibration memory of a simulated unit; None: it is one in memory."""
    return None if settings.eeproms is None else Path(settings.eeproms) / f"{slug(unit.serial)}.eeprom"
