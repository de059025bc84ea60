"""Guards that every run has and no file can take away: what is beyond the chamber, its plant, or its display.

They follow from what the station file says of its chamber. `protection` moves their margins within bounds; guards of
station and profile are added to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, Field

from bench.acquisition.profile.guards import GuardSettings
from bench.acquisition.profile.preflight import Limits
from bench.base import STRICT

SLOPE_OVER_S = 60.0
SLOPE_FACTOR = 4.0
"""Air that changes so many times faster than the chamber's fastest ramp changes for another reason: at full power it is
about twice as fast, with an open door three times."""
SLOWEST_GUARDED_DEGC_PER_MIN = 20.0
"""Below this slope nothing trips, however slow the chamber: a door may stand open."""

DOUBTED_S = 30.0
"""A unit whose temperature is not believed for longer is not protected against heat and cold any more."""


class ProtectionSettings(BaseModel):
    """Margins of the guards that every run has. They end the run; they cannot be switched off."""

    model_config = STRICT

    air_margin_degc: Annotated[float, Field(gt=0, le=20)] = 5.0
    """Air above `highest_degc` or below `lowest_degc` of the chamber by more than this ends the run."""
    unit_margin_degc: Annotated[float, Field(gt=0, le=40)] = 15.0
    """The same for the unit's own sensor, which its electronics warm."""
    setpoint_margin_degc: Annotated[float, Field(gt=0, le=50)] = 8.0
    """Air further from the set point in force than this, beyond what the chamber's speed explains, ends the run …"""
    setpoint_min: Annotated[float, Field(gt=0, le=60)] = 5.0
    """… when it lasts for so many minutes."""
    unit_lag_min: Annotated[float, Field(gt=0, le=600)] = 60.0
    """Longest thermal time constant of a unit in its fixture [min]: what its sensor may lag behind the air."""


@dataclass(frozen=True)
class Standing:
    """A guard of every run and what it says to people."""

    guard: GuardSettings
    text: str


def standing_guards(limits: Limits, protection: ProtectionSettings) -> tuple[Standing, ...]:
    """The guards that follow from a station: its set point limits, the speed of its chamber, its margins."""
    low, high = limits.low_degc - protection.air_margin_degc, limits.high_degc + protection.air_margin_degc
    unit_low, unit_high = limits.low_degc - protection.unit_margin_degc, limits.high_degc + protection.unit_margin_degc
    slope = max(SLOPE_FACTOR * _fastest(limits), SLOWEST_GUARDED_DEGC_PER_MIN)
    apart, apart_min = protection.setpoint_margin_degc, protection.setpoint_min
    lag, lag_min = protection.unit_margin_degc, protection.unit_lag_min
    return (
        Standing(
            GuardSettings(name="air limits", signal="chamber_temperature", above=high, below=low, delay_s=3.0),
            f"chamber air above {high:g} or below {low:g} degC",
        ),
        Standing(
            GuardSettings(name="unit too hot", signal="unit_temperature", above=unit_high, delay_s=3.0, max_age_s=60.0),
            f"unit sensor above {unit_high:g} degC",
        ),
        Standing(
            GuardSettings(name="unit too cold", signal="unit_coldest", below=unit_low, delay_s=3.0, max_age_s=60.0),
            f"unit sensor below {unit_low:g} degC",
        ),
        Standing(
            GuardSettings(
                name="air changes too fast",
                signal="chamber_temperature",
                rate_per_min=slope,
                rate_over_s=SLOPE_OVER_S,
                delay_s=2.0,
            ),
            f"chamber air changes by more than {slope:g} degC/min over {SLOPE_OVER_S:g} s",
        ),
        Standing(
            GuardSettings(
                name="air off its set point", signal="setpoint_excess", above=apart, delay_s=60.0 * apart_min
            ),
            f"chamber air {apart:g} degC further from its set point than its speed explains, for {apart_min:g} min",
        ),
        Standing(
            GuardSettings(name="unit off the air", signal="unit_excess", above=lag, delay_s=60.0, max_age_s=60.0),
            f"unit sensor {lag:g} degC off all that the air was within a lag of {lag_min:g} min, for 1 min",
        ),
        Standing(
            GuardSettings(name="unit not believed", signal="unit_doubted_s", above=DOUBTED_S),
            f"unit sensor that jumped or stands still bit for bit for {DOUBTED_S:g} s",
        ),
        Standing(
            GuardSettings(name="display in degF", signal="display_degf", above=0.5, max_age_s=60.0),
            "chamber air reads as the unit's temperature would in degF before the start",
        ),
    )


def guards_told(guards: Sequence[Standing]) -> str:
    """What they watch, as one sentence."""
    return f"guards of every run: {'; '.join(standing.text for standing in guards)}"


def _fastest(limits: Limits) -> float:
    """Of the ramps that the chamber follows [degC/min]."""
    curves = (limits.heating, limits.cooling)
    return max(float(curve) if isinstance(curve, int | float) else max(rate for _, rate in curve) for curve in curves)
