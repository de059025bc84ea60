"""The section of the station file on the signals of a unit: which of them are its outputs, its counter, its status."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import OUTPUTS, STRICT

Text = Annotated[str, Field(min_length=1)]


class Bits(BaseModel):
    """A signal that no DBC describes."""

    model_config = STRICT

    id: Annotated[int, Field(ge=0, le=0x1FFFFFFF)]
    """CAN identifier of unit number 0; of a packet its number, 0 without `id_at`."""
    extended: bool | None = None
    """29-bit identifier; left out: above 0x7FF."""
    start: Annotated[int, Field(ge=0, le=1983)]
    """First bit as in a DBC: the least significant one, or with `order: big` the most significant one."""
    length: Annotated[int, Field(ge=1, le=64)]
    """Bits."""
    order: Literal["little", "big"] = "little"
    """Byte order."""
    type: Literal["unsigned", "signed", "float"] = "unsigned"
    """Unsigned integer, two's complement, or IEEE 754 with 16, 32 or 64 bits."""
    scale: float = 1.0
    """Value of one step."""
    offset: float = 0.0
    """Value of the code 0."""
    unit: str = ""
    """Unit of the value, as `bench import` takes it: °/h, deg/s, dps, mdps, rad/s; m/s^2, g, mg; °C, K, °F; V, mV; Hz;
    of a time stamp s, ms, us, ns."""
    low: float | None = None
    """Lowest value that is a measurement, with `high`."""
    high: float | None = None
    """Highest value that is a measurement, with `low`."""
    cycle_ms: Annotated[float, Field(gt=0)] | None = None
    """Time from one frame to the next."""
    bytes: Annotated[int, Field(ge=1, le=248)] | None = None
    """Length of the frame or packet; left out: as long as its signals need."""

    @model_validator(mode="after")
    def _possible(self) -> Bits:
        if self.scale == 0.0:
            raise ValueError("scale is 0: every value would be the offset")
        return self


class Status(BaseModel):
    """A signal by which the unit says what its samples are worth."""

    model_config = STRICT

    signal: Text | Bits
    """Name in the DBC, or bits."""
    valid: Text | None = None
    """Raw values with which samples are valid, such as "1" or "0..2,5"; left out: all."""
    raw: Text | None = None
    """Raw values with which the unit sends its raw rate; with others it corrects its rate itself."""


Where = Text | Bits


class SignalSettings(BaseModel):
    """Signals of a unit: a name in its DBC (`Signal` or `Message.Signal`), or bits."""

    model_config = STRICT

    rate: Where | None = None
    """Output of a unit with one axis."""
    rate_x: Where | None = None
    """Gyro x."""
    rate_y: Where | None = None
    """Gyro y."""
    rate_z: Where | None = None
    """Gyro z."""
    acceleration_x: Where | None = None
    """Accelerometer x."""
    acceleration_y: Where | None = None
    """Accelerometer y."""
    acceleration_z: Where | None = None
    """Accelerometer z."""
    temperature: Where | None = None
    """The unit's own thermometer; left out: the air of the chamber takes its place."""
    temperature_1: Where | None = None
    """Thermometer 1; the first one takes the place of `temperature` where that is left out."""
    temperature_2: Where | None = None
    """Thermometer 2."""
    temperature_3: Where | None = None
    """Thermometer 3."""
    temperature_4: Where | None = None
    """Thermometer 4."""
    temperature_5: Where | None = None
    """Thermometer 5."""
    temperature_6: Where | None = None
    """Thermometer 6."""
    temperature_7: Where | None = None
    """Thermometer 7."""
    temperature_8: Where | None = None
    """Thermometer 8."""
    temperature_9: Where | None = None
    """Thermometer 9."""
    frequency: Where | None = None
    """Resonance frequency."""
    drive: Where | None = None
    """Excitation amplitude."""
    quadrature: Where | None = None
    """Quadrature amplitude."""
    supply: Where | None = None
    """Supply voltage."""
    counter: Where | tuple[Where, ...] | None = None
    """Sample counter in the message of the first output; further ones are the low bits of it in other messages.
    One that grows by 2 from sample to sample has the scale 0.5."""
    time_stamp: Where | None = None
    """The unit's own time of a sample, in the message of the first output, instead of a counter."""
    status: tuple[Status, ...] = ()
    """What the unit says of its samples."""
    serial: Where | None = None
    """Serial number in a heartbeat."""
    state: Where | None = None
    """CiA 301 state in the heartbeat; 0 is boot-up."""
    firmware: Where | None = None
    """Firmware in the heartbeat."""
    coefficient_set: Where | None = None
    """Coefficient set in force, in the heartbeat."""
    cycle_ms: Annotated[float, Field(gt=0)] | None = None
    """Time between two samples, where the DBC does not say."""

    @model_validator(mode="after")
    def _measures(self) -> SignalSettings:
        if not any(getattr(self, name) is not None for name in OUTPUTS):
            raise ValueError(f"no output: map at least one of {', '.join(OUTPUTS)}")
        if self.rate is not None and any(getattr(self, f"rate_{axis}") is not None for axis in "xyz"):
            raise ValueError("`rate` is the output of a unit with one axis; name it rate_x, rate_y or rate_z here")
        return self

    def content(self) -> dict[str, Any]:
        """The mapping as it is recorded with a run, and as `drivers.layout` reads it."""
        found: dict[str, Any] = self.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        if self.status:
            found["status"] = [_flat(said) for said in found["status"]]
        return found


def _flat(said: dict[str, Any]) -> dict[str, Any]:
    """Bits beside the values that they may have."""
    where = said["signal"]
    return {**where, **{key: said[key] for key in ("valid", "raw") if key in said}} if isinstance(where, dict) else said
