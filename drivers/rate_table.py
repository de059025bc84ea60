"""Rate tables: the interface of every driver, and the values that they exchange.

Order of use: `identify()`, `prepare()`, `enable()`, `set_rate()`; `poll()` at every tick, which also sends our
heartbeat; `safe()` at the end. Values outside the limits are refused: they are neither sent nor clipped. Drivers do not
clear faults and are not safety devices: the table keeps its own emergency stop.
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
"""Rate below which the table counts as stopped [deg/s]; encoders and servos are never completely still."""


@dataclass(frozen=True)
class TableLimits:
    """Limits of the table."""

    rate_dps: float
    """Highest rate, in either direction [deg/s]."""
    accel_dps2: float
    """Highest acceleration [deg/s^2], and its default."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and value > 0 for value in (self.rate_dps, self.accel_dps2)):
            raise ConfigError(f"rate table limits {self.rate_dps} deg/s, {self.accel_dps2} deg/s^2 must be above 0")

    def check(self, rate_dps: float, accel_dps2: float) -> None:
        """LimitError outside the limits; call it before anything is sent."""
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
        """Limits of the table."""

    @property
    def commanded_dps(self) -> float:
        """Rate that was commanded last [deg/s]; 0 before."""

    enabled: bool
    """Whether we have switched the axis on; if so, `safe` stops it."""

    def identify(self) -> str:
        """Identity as text; IdentityError when it is not the table that the station describes. Writes nothing."""

    def prepare(self) -> tuple[str, ...]:
        """Set up readings and supervision, nothing moves; returns what the table does not support, as text."""

    def enable(self) -> None:
        """Switch the axis on at rate 0."""

    def set_rate(self, rate_dps: float, accel_dps2: float | None = None) -> None:
        """Command `rate_dps` [deg/s], written and read back; does not wait until the table reaches it."""

    def rate(self) -> float:
        """Current encoder rate [deg/s]."""

    def position(self) -> float:
        """Current encoder position [deg]."""

    def poll(self) -> TableArray:
        """Encoder readings since the last call; sends our heartbeat. LinkError when the table does not answer."""

    def stop(self) -> None:
        """Stop with the usual acceleration and wait for the standstill."""

    def safe(self) -> list[SafeStep]:
        """Stop by the table's quick stop, then switch off; verified by reading. Never raises."""

    def close(self) -> None:
        """Close the link."""


def table_array(rows: Iterable[tuple[float, float, float]]) -> TableArray:
    """Readings as an array (n,)."""
    return np.array(list(rows), dtype=TABLE)


def attempt(what: str, action: Callable[[], str]) -> SafeStep:
    """One step to the safe state; `action` returns what it verified. Never raises, so that all steps are tried."""
    try:
        return SafeStep(what, True, action())
    except DriverError as error:
        return SafeStep(what, False, f"{error}; press its emergency stop")
    except Exception as error:
        return SafeStep(what, False, f"{type(error).__name__}: {error}; press its emergency stop")
