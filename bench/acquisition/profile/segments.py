"""The segments of a profile's file: ramp, soak, step, rate, tumble, power cycle, repeat; and what settled means."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, Field, model_validator

from bench.base import STRICT, nearest_or_all
from bench.record import ATTITUDES, tumble

Degc = Annotated[float, Field(ge=-273.15, le=1000)]
Rate = Annotated[float, Field(ge=0.001, le=100)]
"""Of a ramp [degC/min]; the slowest takes half a day for one degree."""
Minutes = Annotated[float, Field(ge=0, le=100_000)]
Positive = Annotated[float, Field(gt=0, le=100_000)]
Turn = Annotated[float, Field(ge=-10_000, le=10_000)]
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[^\x00-\x1f]+$")]


def _known(name: str) -> str:
    if name not in ATTITUDES:
        raise ValueError(f"attitude {name!r} is not known{nearest_or_all(name, ATTITUDES)}")
    return name


AttitudeName = Annotated[str, AfterValidator(_known)]
"""How the unit stands: x_up to z_down, or an edge or corner such as +x-y_up."""
Attitudes = Literal[6, 12, 24] | Annotated[tuple[AttitudeName, ...], Field(min_length=1, max_length=200)]
"""Those of a tumble of so many positions, or a list."""


def names_of(attitudes: Attitudes) -> tuple[str, ...]:
    """Attitudes written out."""
    return tuple(one.name for one in tumble(attitudes)) if isinstance(attitudes, int) else attitudes


class SettleRule(BaseModel):
    """When a temperature counts as settled: all of it, for the whole dwell time."""

    model_config = STRICT

    band_degc: Positive = 0.5
    """Largest distance of the chamber air from the target."""
    unit_band_degc: Positive = 3.0
    """Largest distance of the unit's own sensor from the target; it heats itself, so more than the air's."""
    slope_degc_per_min: Positive = 0.05
    """Largest slope of the unit's own sensor over the dwell time."""
    dwell_min: Positive = 5.0
    """How long all of it must hold."""
    timeout_min: Positive = 120.0
    """A target that has not settled after this time is a failed segment."""

    @property
    def dwell_s(self) -> float:
        """How long all of it must hold [s]."""
        return 60.0 * self.dwell_min


class SettleChange(BaseModel):
    """Values that differ from the profile's `settle`, for one segment."""

    model_config = STRICT

    band_degc: Positive | None = None
    unit_band_degc: Positive | None = None
    slope_degc_per_min: Positive | None = None
    dwell_min: Positive | None = None
    timeout_min: Positive | None = None


class Ramp(BaseModel):
    """Move the set point at a constant rate; ends when the chamber air has arrived."""

    model_config = STRICT

    kind: Literal["ramp"]
    name: Name | None = None
    to_degc: Degc
    """Temperature at the end."""
    rate_degc_per_min: Rate | None = None
    """Rate in both directions; left out: the rate of its direction in `rates`."""
    arrival_band_degc: Positive = 1.0
    """The ramp has arrived when the chamber air is this near."""
    timeout_min: Positive = 60.0
    """Time that the chamber may be late."""
    turn_dps: Turn = 0.0
    """Rate of the table meanwhile [deg/s]; the station needs one."""
    attitude: AttitudeName | None = None
    """How the unit stands from its beginning on; left out: as before. The station needs a `fixture`."""


class Soak(BaseModel):
    """Keep the set point for a time, until settled, or both."""

    model_config = STRICT

    kind: Literal["soak"]
    name: Name | None = None
    duration_min: Minutes | None = None
    """Shortest duration."""
    until: Literal["settled"] | None = None
    """Wait also until the temperature has settled."""
    settle: SettleChange | None = None
    """Values that differ from the profile's `settle`."""
    turn_dps: Turn = 0.0
    """Rate of the table meanwhile [deg/s]; the station needs one."""
    attitude: AttitudeName | None = None
    """How the unit stands from its beginning on; left out: as before. The station needs a `fixture`."""

    @model_validator(mode="after")
    def _ends(self) -> Soak:
        if self.duration_min is None and self.until is None:
            raise ValueError("a soak needs duration_min, `until: settled`, or both")
        if self.settle is not None and self.until is None:
            raise ValueError("`settle` has no effect without `until: settled`; add it or remove `settle`")
        return self


class Step(BaseModel):
    """Fixed temperatures: go there, settle, average. The classic method."""

    model_config = STRICT

    kind: Literal["step"]
    name: Name | None = None
    temperatures_degc: Annotated[tuple[Degc, ...], Field(min_length=1, max_length=200)]
    """Temperatures in their order."""
    average_min: Positive = 10.0
    """Averaging time at each of them, after it has settled."""
    settle: SettleChange | None = None
    """Values that differ from the profile's `settle`."""
    turn_dps: Turn = 0.0
    """Rate of the table meanwhile, on the way and while averaging [deg/s]; the station needs one."""
    attitude: AttitudeName | None = None
    """How the unit stands from its beginning on; left out: as before. The station needs a `fixture`."""


class RateSteps(BaseModel):
    """Fixed temperature, several rates of the rate table, one after the other."""

    model_config = STRICT

    kind: Literal["rate"]
    name: Name | None = None
    rates_dps: Annotated[tuple[Turn, ...], Field(min_length=1, max_length=200)]
    """Rates in their order [deg/s]; 0 is a stand."""
    dwell_s: Positive
    """Time at each of them, once the table has got there [s]."""
    both_directions: bool = True
    """Each rate is followed by the same one the other way; what it leaves of a cable's twist is undone."""
    temperatures_degc: Annotated[tuple[Degc, ...], Field(min_length=1, max_length=200)] | None = None
    """Go to each of these, settle with the table standing, and turn there; left out: where the chamber stands."""
    settle: SettleChange | None = None
    """Values that differ from the profile's `settle`."""
    attitudes: Attitudes | None = None
    """Turn in each of these, at each temperature; left out: as the unit stands. The station needs a `fixture`."""

    @model_validator(mode="after")
    def _settles(self) -> RateSteps:
        if self.settle is not None and self.temperatures_degc is None:
            raise ValueError("`settle` has no effect without `temperatures_degc`; add them or remove `settle`")
        return self

    def turns(self) -> tuple[float, ...]:
        """All rates in their order, both directions written out [deg/s]."""
        if not self.both_directions:
            return self.rates_dps
        return tuple(turn for rate in self.rates_dps for turn in ((rate, -rate) if rate else (0.0,)))


class Tumble(BaseModel):
    """Several attitudes, one after the other, at a standing temperature or throughout a slow ramp."""

    model_config = STRICT

    kind: Literal["tumble"]
    name: Name | None = None
    attitudes: Attitudes
    """Those of a tumble of 6, 12 or 24 positions, or a list of names in their order; the station needs a `fixture`."""
    dwell_min: Positive
    """Time in each of them."""
    to_degc: Degc | None = None
    """Temperature at the end, which the set point reaches in equal parts; left out: it stands."""


class PowerCycle(BaseModel):
    """Switch the units off for a time and on again where the chamber stands, and wait until they have settled.

    Each power-on draws a new turn-on bias; the station needs a `supply`.
    """

    model_config = STRICT

    kind: Literal["power_cycle"]
    name: Name | None = None
    off_min: Annotated[float, Field(ge=0.05, le=10_000)]
    """Time without power."""
    on_min: Minutes = 0.0
    """Shortest time after the power is back; it also has to be settled."""
    settle: SettleChange | None = None
    """Values that differ from the profile's `settle`."""


class Repeat(BaseModel):
    """Segments to be repeated."""

    model_config = STRICT

    kind: Literal["repeat"]
    times: Annotated[int, Field(ge=1, le=1000)]
    """How often."""
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    """What."""


Simple = Ramp | Soak | Step | RateSteps | Tumble | PowerCycle
"""A segment that is no repeat."""
Segment = Annotated[Simple | Repeat, Field(discriminator="kind")]
Repeat.model_rebuild()


class Start(BaseModel):
    """Where the profile starts."""

    model_config = STRICT

    temperature_degc: Degc
    """The chamber goes there and settles before the first segment."""
    soak_min: Minutes = 0.0
    """Time there after it has settled."""
    attitude: AttitudeName | None = None
    """How the unit stands there and from there on; the station needs a `fixture`."""


class Rates(BaseModel):
    """Fastest ramps, one limit a direction; ramps without a rate of their own use them, faster ones are refused."""

    model_config = STRICT

    heating_degc_per_min: Rate
    """Limit when heating."""
    cooling_degc_per_min: Rate
    """Limit when cooling: most chambers cool slower than they heat."""
