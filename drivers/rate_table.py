"""Rate tables: what every driver offers, and the values that they exchange.

Order of use: `identify()`, `prepare()`, `enable()`, `set_rate()`; `poll()` at every tick, which also tells the table
that we are alive; `safe()` at the end. Nothing outside the limits is ever sent, and nothing is clipped to them. No
driver clears a fault, and none is a safety device: the table keeps its own emergency stop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivers.chamber import SafeStep
from drivers.errors import ConfigError, DriverError, LimitError

__all__ = ["TABLE", "RateTable", "SafeStep", "TableArray", "TableLimits", "attempt", "table_array"]

TABLE = np.dtype([("t_s", "<f8"), ("rate_dps", "<f8"), ("position_deg", "<f8")])
"""One reading of the table's encoder: bench time [s], rate [deg/s], position [deg]."""

TableArray = npt.NDArray[np.void]

STOPPED_DPS = 0.1
"""Slower than this the table stands [deg/s]; encoders and servos are never quite still."""


@dataclass(frozen=True)
class TableLimits:
    """What may be asked of the table."""

    rate_dps: float
    """Fastest rate, either way [deg/s]."""
    accel_dps2: float
    """Strongest acceleration [deg/s^2]; used when none is given."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and value > 0 for value in (self.rate_dps, self.accel_dps2)):
            raise ConfigError(f"rate table limits {self.rate_dps} deg/s, {self.accel_dps2} deg/s^2 must be above 0")

    def check(self, rate_dps: float, accel_dps2: float) -> None:
        """LimitError when the table may not do this; call it before anything is sent."""
        if not abs(rate_dps) <= self.rate_dps:
            text = f"rate {rate_dps:g} deg/s is outside the limits +-{self.rate_dps:g} deg/s; nothing was sent"
            raise LimitError(text)
        if not 0 < accel_dps2 <= self.accel_dps2:
            text = f"acceleration {accel_dps2:g} deg/s^2 is not between 0 and {self.accel_dps2:g}; nothing was sent"
            raise LimitError(text)


class RateTable(Protocol):
    """A rate table. All methods raise DriverError subclasses, except `safe` and `close`."""

    @property
    def limits(self) -> TableLimits:
        """What may be asked of it."""

    @property
    def commanded_dps(self) -> float:
        """Rate that was commanded last [deg/s]; 0 before."""

    enabled: bool
    """Whether we have switched the axis on: then `safe` has to stop it."""

    def identify(self) -> str:
        """Who answers; IdentityError when it is not the table that the station describes. Nothing is written."""

    def prepare(self) -> tuple[str, ...]:
        """Set up readings and supervision, nothing moves; what the table does not have of it, as text."""

    def enable(self) -> None:
        """Switch the axis on, standing."""

    def set_rate(self, rate_dps: float, accel_dps2: float | None = None) -> None:
        """Go to `rate_dps` [deg/s]; written and read back, the table needs its time to get there."""

    def rate(self) -> float:
        """Rate by the encoder, now [deg/s]."""

    def position(self) -> float:
        """Position by the encoder, now [deg]."""

    def poll(self) -> TableArray:
        """Encoder readings since the last call, and a sign of life; LinkError when the table is silent."""

    def stop(self) -> None:
        """Come to a stand with the usual acceleration and wait for it."""

    def safe(self) -> list[SafeStep]:
        """Stop as fast as the table's quick stop does, then switch off; verified by reading. Never raises."""

    def close(self) -> None:
        """Let go of the link."""


def table_array(rows: Iterable[tuple[float, float, float]]) -> TableArray:
    """Readings as an array (n,)."""
    return np.array(list(rows), dtype=TABLE)


def attempt(what: str, action: Callable[[], str]) -> SafeStep:
    """One step to the safe state; `action` returns what it verified. The way goes on whatever happens."""
    try:
        return SafeStep(what, True, action())
    except DriverError as error:
        return SafeStep(what, False, f"{error}; press its emergency stop")
    except Exception as error:
        return SafeStep(what, False, f"{type(error).__name__}: {error}; press its emergency stop")
