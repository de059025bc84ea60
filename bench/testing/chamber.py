"""A simulated chamber behind a Modbus TCP server, for tests of programs that drive one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from bench.testing.passing import Passing, staged

if TYPE_CHECKING:
    from bench.testing.stations import BenchStation


class SimulatedChamber(Passing):
    """What stands behind the server, seen from inside: no wire and no driver is between it and the test."""

    @property
    def url(self) -> str:
        """Where it listens: `tcp://127.0.0.1:PORT`."""
        return self._stage.connection.url

    @property
    def port(self) -> int:
        """TCP port on 127.0.0.1, chosen by the system."""
        return int(self.url.rpartition(":")[2])

    @property
    def setpoint_degc(self) -> float:
        """Set point that it was given [degC]."""
        return self._stage.station.chamber.commands().setpoint

    @property
    def on(self) -> bool:
        """Whether it was told to run."""
        return self._stage.station.chamber.commands().on

    @property
    def ramp_degc_per_min(self) -> float | None:
        """Rate at which it was told to move its set point; None: it jumps."""
        return self._stage.station.chamber.commands().ramp_rate_degc_per_min

    @property
    def air_degc(self) -> float:
        """True temperature of its air [degC]."""
        return self._stage.station.plant.state.air

    def words(self, register: str) -> list[int]:
        """Raw words of a register, by its name in the map."""
        return self._stage.station.chamber.words(register)

    def set_value(self, register: str, value: float | str) -> None:
        """Write a value to a register, as somebody at its panel would."""
        self._stage.station.chamber.set_value(register, value)


@contextmanager
def open_chamber(station: BenchStation) -> Iterator[SimulatedChamber]:
    """The chamber of a station alone."""
    with staged(station, units=False) as (stage, clock):
        yield SimulatedChamber(stage, clock)
